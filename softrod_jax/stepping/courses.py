"""Courses of what is carried: smooth curves through a pose at the end of every step.

A clamp that is moved needs a velocity beside its pose, and one that does not jump from step to
step: an impulse would follow. So poses are joined by cubic polynomials, whose slopes at the ends of
steps are differences of fourth order (of third order at the last step). At first everything
is at rest, as the rod is: the course before the first step is the mirror image of that after it.

Step by step, where the next pose is not known, slopes are differences of third order that look
back.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from softrod_jax.rod.carried import Carried, Surroundings
from softrod_jax.rod.rotations import conjugate, quaternion_product
from softrod_jax.rod.shape import ORIGIN
from softrod_jax.scene.poses import Poses

# Positions and quaternions, a pose in one row.
Rows = Float[Array, "*steps 7"]


class Course(NamedTuple):
    """Of every step the poses at both ends, and their slopes there, per step; (steps, 7) each."""

    before: Rows
    now: Rows
    slope_before: Rows
    slope_now: Rows

    def at(self, progress, dt) -> Carried:
        """At `progress` in [0, 1] of a step of `dt` [s]."""
        t, rest = progress, 1 - progress
        # Hermite's cubic, and its slope per step.
        x = rest**2 * (1 + 2 * t) * self.before + t**2 * (3 - 2 * t) * self.now
        x = x + t * rest**2 * self.slope_before - t**2 * rest * self.slope_now
        slope = 6 * t * rest * (self.now - self.before) + rest * (1 - 3 * t) * self.slope_before
        slope = (slope + t * (3 * t - 2) * self.slope_now) / dt
        h, h_t = x[..., 3:], slope[..., 3:]
        square = jnp.sum(h * h, -1, keepdims=True)
        turning = 2 * quaternion_product(conjugate(h), h_t)[..., 1:] / square
        return Carried(x[..., :3], h / jnp.sqrt(square), slope[..., :3], turning)


def course_of(first: Float[Array, "7"], poses: Rows) -> Course:
    """The course from the pose `first` on through `poses`, those at the ends of the steps."""
    every = _without_flips(jnp.concatenate([first[None], poses]))
    second = every[2:3] if every.shape[0] > 2 else 4 * every[1:2] - 3 * every[:1]
    beyond = jnp.concatenate([second, every[1:2], every])
    for _ in range(2):  # a cubic beyond the last
        a, b, c, d = (beyond[-k, None] for k in (1, 2, 3, 4))
        beyond = jnp.concatenate([beyond, 4 * a - 6 * b + 4 * c - d])
    far, near = beyond[4:] - beyond[:-4], beyond[3:-1] - beyond[1:-3]
    slopes = (8 * near - far) / 12
    return Course(every[:-1], every[1:], slopes[:-1], slopes[1:])


def _without_flips(poses: Rows) -> Rows:
    """Of a quaternion and its negative, which turn alike, the one close to the last."""
    h = poses[:, 3:]
    flips = jnp.where(jnp.sum(h[1:] * h[:-1], -1) < 0, -1.0, 1.0)
    sign = jnp.concatenate([jnp.ones(1), jnp.cumprod(flips)])[:, None]
    return jnp.concatenate([poses[:, :3], sign * h], -1)


class Courses(NamedTuple):
    """Those of the base and of all obstacles; `None` for what stands still.

    `good`: whether each step can be; where it cannot, everything stays where it begins.
    """

    base: Course | None = None
    obstacles: tuple[Course | None, ...] = ()
    good: Bool[Array, "*steps"] | None = None

    def at(self, progress, dt) -> Surroundings:
        """At `progress` of a step of `dt` [s]."""
        here = lambda course: None if course is None else course.at(progress, dt)
        return Surroundings(here(self.base), tuple(here(x) for x in self.obstacles))


def courses_of(poses: Poses, clamp) -> Courses:
    """Those of what is carried. `clamp`: the pose in which the base begins.

    Obstacles begin where the scene has them.
    """
    given = [x for x in (poses.base, *poses.obstacles) if x is not None]
    if not given:
        return Courses()
    good = jnp.all(jnp.isfinite(jnp.concatenate(given, -1)), -1)

    def course(first, rows):
        first = jnp.concatenate([jnp.asarray(x) for x in first])
        return None if rows is None else course_of(first, jnp.where(good[:, None], rows, first))

    obstacles = tuple(course(ORIGIN, rows) for rows in poses.obstacles)
    return Courses(course(clamp, poses.base), obstacles, good)


class Past(NamedTuple):
    """Of one that is carried step by step: its last three poses, newest first, and its slope."""

    poses: Float[Array, "3 7"]
    slope: Float[Array, "7"]

    @property
    def pose(self) -> tuple[Float[Array, "3"], Float[Array, "4"]]:
        """The newest: position and unit quaternion."""
        p, h = self.poses[0, :3], self.poses[0, 3:]
        return p, h / jnp.sqrt(h @ h)


class Pasts(NamedTuple):
    """Those of the base and of all obstacles, in the form of `Poses`."""

    base: Past | None = None
    obstacles: tuple[Past | None, ...] = ()


def at_rest(pose) -> Past:
    """Of what stands in a pose, position and quaternion."""
    first = jnp.concatenate([jnp.asarray(x, dtype=float) for x in pose])
    return Past(jnp.tile(first, (3, 1)), jnp.zeros(7))


def go_on(pasts: Pasts, poses: Poses, first: Bool[Array, ""]) -> tuple[Pasts, Courses]:
    """One step on to `poses`, (7,) each; `first`: whether it is the first one.

    Where a pose cannot be, everything stays where it is.
    """
    given = [x for x in (poses.base, *poses.obstacles) if x is not None]
    if not given:
        return pasts, Courses()
    good = jnp.all(jnp.isfinite(jnp.concatenate(given)))

    def one(past, pose):
        if past is None:
            return None, None
        return _gone_on(past, jnp.where(good, pose, past.poses[0]), first)

    base = one(pasts.base, poses.base)
    each = [one(*x) for x in zip(pasts.obstacles, poses.obstacles, strict=True)]
    courses = Courses(base[1], tuple(course for _, course in each), good)
    return Pasts(base[0], tuple(past for past, _ in each)), courses


def _gone_on(past: Past, pose: Float[Array, "7"], first) -> tuple[Past, Course]:
    now = _without_flips(jnp.stack([past.poses[0], pose]))[1]
    start = past.poses[0]
    mirrored = jnp.stack([start, now, 4 * now - 3 * start])
    a, b, c = jnp.where(first, mirrored, past.poses)
    slope = (11 * now - 18 * a + 9 * b - 2 * c) / 6
    return Past(jnp.stack([now, a, b]), slope), Course(start, now, past.slope, slope)
