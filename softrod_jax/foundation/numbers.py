"""What annotations call the numbers that users give: those of JAX and of numpy, and Python's own.

What is computed with are arrays of JAX, `Float[Array, ..]` with the names of their axes. What is
given may be anything that `jnp.asarray` makes such an array of; the calls do that, not the classes.
So a scene has what it was given until a call takes it. A batch of scenes has a first axis.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Generic, TypeVar

import numpy as np
from jaxtyping import Array, Real

ScalarLike = Real[Array | np.ndarray, "..."] | float | np.number
# One number, or one for each of x, y, z.
DiagonalLike = ScalarLike | Sequence[ScalarLike]
PairLike = Real[Array | np.ndarray, "... 2"] | Sequence[ScalarLike]
VectorLike = Real[Array | np.ndarray, "... 3"] | Sequence[ScalarLike]
QuaternionLike = Real[Array | np.ndarray, "... 4"] | Sequence[ScalarLike]
# A number for each of several; and rows of numbers, one for each of several or one a step.
ManyLike = Real[Array | np.ndarray, "..."] | Sequence[ScalarLike]
RowsLike = Real[Array | np.ndarray, "..."] | Sequence[ManyLike]

if TYPE_CHECKING:
    _Like = TypeVar("_Like")

    class Given(Generic[_Like]):
        """A field that takes what is like an array, and that is read as an array."""

        def __get__(self, owner: object, kind: type | None = None) -> Array: ...
        def __set__(self, owner: object, value: _Like) -> None: ...

    class Maybe(Generic[_Like]):
        """The same, of what may be absent."""

        def __get__(self, owner: object, kind: type | None = None) -> Array | None: ...
        def __set__(self, owner: object, value: _Like | None) -> None: ...

else:
    # When a program runs, such a field is what it was given.
    class Given:
        def __class_getitem__(cls, like):
            return like

    class Maybe:
        def __class_getitem__(cls, like):
            return like | None
