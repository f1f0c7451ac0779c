"""A parameter: a number of a setup, or several that change together."""

import abc
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import equinox as eqx
import jax.numpy as jnp

from calibration.experiment.setup import Setup
from calibration.parameters.scales import AbstractScale, Factor


@dataclass(frozen=True)
class AbstractParameter(abc.ABC):
    """Where a value is in a `Setup`, and how it moves.

    - `remedy`: what to add to a scene that lacks it.
    - `allowed`: whether a setup's value can be; None if every one of its scale can.
    """

    name: str
    unit: str
    scale: AbstractScale = field(default=Factor(), kw_only=True)
    remedy: str = field(default="", kw_only=True)
    allowed: Callable | None = field(default=None, kw_only=True)

    @abc.abstractmethod
    def get(self, setup: Setup) -> Any:
        """The value in `setup`; None if it has none."""

    @abc.abstractmethod
    def put(self, setup: Setup, value) -> Setup:
        """The setup with another value."""

    def prepare(self, setup: Setup) -> Setup:
        """The setup with a place for the value."""
        return setup


@dataclass(frozen=True)
class Parameter(AbstractParameter):
    """One number, or several that are scaled together.

    - `find`: the array it is in, in a `Setup`; `index` in that array, None for all of it. Or a
      tuple of numbers, of which some may be None, as tendons have them: all those there are, or
      the one at `index`.
    - `make`: puts the array into a setup that has none, at values that change nothing; None if
      the scene must have it.
    """

    find: Callable
    index: int | tuple[int, ...] | None = None
    make: Callable | None = None

    def get(self, setup: Setup):
        """The value in `setup`; None if it has none."""
        array = self.find(setup)
        if isinstance(array, tuple):
            if isinstance(self.index, int):
                return array[self.index]
            numbers = [x for x in array if x is not None]
            return jnp.stack(numbers) if numbers else None
        return array if array is None or self.index is None else array[self.index]

    def put(self, setup: Setup, value) -> Setup:
        """The setup with another value."""
        there = self.find(setup)
        if isinstance(there, tuple):
            one = lambda i: self.index is None or self.index == i
            numbers = iter(value if self.index is None else (value,))
            own = [one(i) and x is not None for i, x in enumerate(there)]
            value = tuple(next(numbers) if mine else x for mine, x in zip(own, there))
        elif self.index is not None:
            value = self.find(setup).at[self.index].set(value)
        return eqx.tree_at(self.find, setup, value)

    def prepare(self, setup: Setup) -> Setup:
        """The setup with the array there, at values that change nothing."""
        return setup if self.find(setup) is not None or self.make is None else self.make(setup)
