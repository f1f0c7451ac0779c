"""Methods of a pytree that `jax.jit` takes as they are: `jax.jit(stepper.step)`.

`jax.jit` keeps programs by the function, for which it must have a hash. A bound method of an
equinox module has that of its numbers, and arrays have none.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar

import equinox as eqx
import jax

Method = TypeVar("Method", bound=Callable)


class _Bound(eqx.Module):
    """A method and what it is bound to: the same where both hold the same arrays."""

    method: Callable = eqx.field(static=True)
    owner: Any

    def __call__(self, *args, **kwargs):
        return self.method(self.owner, *args, **kwargs)

    def __hash__(self):
        leaves, structure = jax.tree.flatten(self.owner)
        return hash((self.method, structure, *map(id, leaves)))

    def __eq__(self, other):
        if not isinstance(other, _Bound) or self.method is not other.method:
            return False
        ours, theirs = jax.tree.flatten(self.owner), jax.tree.flatten(other.owner)
        same = len(ours[0]) == len(theirs[0]) and ours[1] == theirs[1]
        return same and all(a is b for a, b in zip(ours[0], theirs[0], strict=True))


class _Binding:
    """The descriptor: what a class has in the place of the method."""

    def __init__(self, method):
        self.method, self.__doc__ = method, method.__doc__

    def __get__(self, owner, kind=None):
        return self.method if owner is None else _Bound(self.method, owner)


if TYPE_CHECKING:

    def hashable(method: Method) -> Method:
        """For who reads types, the method itself."""
        return method

else:
    # A decorator of an equinox module's method, whose arrays become constants under `jax.jit`.
    hashable = _Binding
