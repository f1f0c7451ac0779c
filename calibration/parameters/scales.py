"""How a value depends on the coordinate theta that an optimiser moves: 0 at the initial value.

A step of about 1 in theta is a large change for every scale, and theta has no forbidden values.
"""

import abc
from dataclasses import dataclass
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

# A fit does not leave these factors around the initial value: where the data say nothing of a
# parameter, its estimate would run to 0 or to infinity.
LARGEST_FACTOR = 1e6


@dataclass(frozen=True)
class AbstractScale(abc.ABC):
    """`value` of theta, and back; what is far, vague and well known in terms of theta.

    - `largest`: how far theta may go from 0 on either side.
    - `vague`: a standard error above which linearisation is not trusted.
    - `identified`: the widest 95 % interval that still counts as knowing the parameter.
    """

    largest: ClassVar[float]
    vague: ClassVar[float]
    identified: ClassVar[float]

    @abc.abstractmethod
    def value(self, initial, theta) -> Any:
        """The value at `theta`."""

    @abc.abstractmethod
    def theta(self, initial, value) -> float:
        """The coordinate of `value`; raises `ValueError` for one that is not allowed."""

    @abc.abstractmethod
    def limited(self, step: float) -> tuple[float, float]:
        """A step of an optimiser that is proportional to the value's, kept from overshooting, and
        the change of theta that it stands for."""


_LARGEST_FALL, _LARGEST_RISE = -0.8, 1e4  # of a value in one step, relative


@dataclass(frozen=True)
class Factor(AbstractScale):
    """value = initial exp(theta): positive, and a step means the same for all magnitudes.

    An interval counts as known if its ends are less than a factor of four apart: a damping
    known to within an order of magnitude is not known.
    """

    largest = float(np.log(LARGEST_FACTOR))
    vague = 0.25
    identified = float(np.log(4.0))

    def value(self, initial, theta):
        return initial * jnp.exp(theta)

    def theta(self, initial, value):
        if not value > 0:
            raise ValueError("a number above 0 is needed")
        return float(np.log(value / np.max(np.abs(initial))))

    def limited(self, step):
        # What a damping or a drag does is linear in it, so that one that is far too small gets
        # where it should be at once, and not by a limited number of doublings.
        step = min(max(step, _LARGEST_FALL), _LARGEST_RISE)
        return step, float(np.log1p(step))


@dataclass(frozen=True)
class Between(AbstractScale):
    """A value in the open interval (low, high): its logit moves by theta."""

    low: float
    high: float
    largest = float(np.log(LARGEST_FACTOR))
    vague = 0.25
    identified = float(np.log(4.0))

    def value(self, initial, theta):
        start = jnp.log((initial - self.low) / (self.high - initial))
        return self.low + (self.high - self.low) * jax.nn.sigmoid(start + theta)

    def theta(self, initial, value):
        if not self.low < value < self.high:
            raise ValueError(f"a number between {self.low:g} and {self.high:g} is needed")
        logit = lambda x: np.log((x - self.low) / (self.high - x))
        return float(logit(value) - logit(initial))

    def limited(self, step):
        return step, step


@dataclass(frozen=True)
class Shift(AbstractScale):
    """value = initial + size theta, of either sign; `size`: a change that matters."""

    size: float
    largest = 50.0
    vague = 5.0
    identified = 10.0

    def value(self, initial, theta):
        return initial + self.size * theta

    def theta(self, initial, value):
        return float((value - initial) / self.size)

    def limited(self, step):
        step = min(max(step, -5.0), 5.0)
        return step, step
