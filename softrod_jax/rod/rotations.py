"""Rotations and rigid motions: unit quaternions (w, x, y, z) and exponentials.

In a plane, a vector has two components, a turn (curvature, angular velocity, moment) has one, and
an attitude is an angle (1,), which turns from the second axis to the first. `hats`, `cross` and
`to_body` tell by the sizes what they are given.

Small angles: coefficients such as sin(x)/x switch to their Taylor series, and the branch that
is not taken sees a safe argument ("double where"), so that no derivative is NaN at zero.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

# What two arguments have beside their components is broadcast.
Vector = Float[Array, "*#batch 3"]
Quaternion = Float[Array, "*#batch 4"]
Matrix = Float[Array, "*#batch 3 3"]

# Below this squared angle the series to angle^8 is exact to rounding in float64.
_SMALL = 1e-2


def _components(a) -> Sequence[jax.Array]:
    """Its components, each with an axis of its own: fewer operations to trace than by indexing."""
    return jax.lax.split(a, (1,) * a.shape[-1], axis=a.ndim - 1)


def _rows(*rows):
    """A matrix of components."""
    entries = jnp.concatenate([x for row in rows for x in row], -1)
    return jnp.reshape(entries, (*entries.shape[:-1], len(rows), -1))


def hat(a: Vector) -> Matrix:
    """The matrix of `a x`: hat(a) @ b = a x b (paper, eq. 2)."""
    x, y, z = _components(a)
    o = jnp.zeros_like(x)
    return _rows([o, -z, y], [z, o, -x], [-y, x, o])


def hats(
    a: Float[Array, "*batch n"],
) -> tuple[Float[Array, "*batch _ vector"], Float[Array, "*batch _ turn"]]:
    """The matrices of `a x` for vectors and for turns: one and the same, but in a plane."""
    if a.shape[-1] == 3:
        matrix = hat(a)
        return matrix, matrix
    if a.shape[-1] == 1:  # a turn
        o = jnp.zeros_like(a)
        return _rows([o, a], [-a, o]), _rows([o])
    x, z = _components(a)
    return _rows([z, -x]), _rows([-z], [x])


def cross(a: Float[Array, "*#batch n"], b: Float[Array, "*#batch m"]) -> Float[Array, "*#batch k"]:
    """a x b, in components (jnp.cross compiles to gathers)."""
    if a.shape[-1] < 3:
        return _cross_in_plane(a, b)
    (ax, ay, az), (bx, by, bz) = _components(a), _components(b)
    return jnp.concatenate([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], -1)


def _cross_in_plane(a, b):
    match a.shape[-1], b.shape[-1]:
        case 1, 1:
            return jnp.zeros_like(a * b)
        case 1, 2:
            return jnp.concatenate([a * b[..., 1:], -a * b[..., :1]], -1)
        case 2, 1:
            return jnp.concatenate([-a[..., 1:] * b, a[..., :1] * b], -1)
    return a[..., 1:] * b[..., :1] - a[..., :1] * b[..., 1:]


def quaternion_product(a: Quaternion, b: Quaternion) -> Quaternion:
    """a o b: first b, then a."""
    (aw, ax, ay, az), (bw, bx, by, bz) = _components(a), _components(b)
    return jnp.concatenate(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        -1,
    )


def conjugate(h: Quaternion) -> Quaternion:
    """The rotation back, of a unit quaternion."""
    return h * jnp.array([1.0, -1.0, -1.0, -1.0])


def turn_between(h: Quaternion, start: Quaternion) -> Vector:
    """The vector of the quaternion that turns `start` into `h`, the short way, in the base frame.

    Of a small turn, half the rotation vector [rad].
    """
    turn = quaternion_product(h, conjugate(start))
    return jnp.where(turn[..., :1] < 0, -turn[..., 1:], turn[..., 1:])


def rotation_matrix(h: Quaternion) -> Matrix:
    """R(h), body to base; `h` need not be normalised."""
    w, x, y, z = _components(h)
    k = 2 / (w * w + x * x + y * y + z * z)
    return _rows(
        [1 - k * (y * y + z * z), k * (x * y - w * z), k * (x * z + w * y)],
        [k * (x * y + w * z), 1 - k * (x * x + z * z), k * (y * z - w * x)],
        [k * (x * z - w * y), k * (y * z + w * x), 1 - k * (x * x + y * y)],
    )


def half_angle(h: Float[Array, "*batch attitude"]) -> Float[Array, "*batch n"]:
    """In a plane, cosine and sine of half the angle, computed once; a quaternion as it is.

    The compiler would compute them again for every number that depends on them.
    """
    if h.shape[-1] != 1:
        return h
    pair = jnp.concatenate([jnp.cos(0.5 * h), jnp.sin(0.5 * h)], -1)
    return jax.lax.optimization_barrier(pair)


def _cosine_and_sine(h: Float[Array, "*batch n"]):
    """Of an angle, or of twice that of which `h` has them."""
    if h.shape[-1] == 1:
        return jnp.cos(h), jnp.sin(h)
    c, s = h[..., :1], h[..., 1:]
    return c * c - s * s, 2 * s * c


def to_body(
    h: Float[Array, "*#batch attitude"], a: Float[Array, "*#batch vector"]
) -> Float[Array, "*#batch vector"]:
    """R(h)^T a: a vector of the base frame, seen from the body."""
    if h.shape[-1] <= 2:
        (c, s), x, z = _cosine_and_sine(h), a[..., :1], a[..., 1:]
        return jnp.concatenate([c * x - s * z, s * x + c * z], -1)
    w, r = h[..., :1], h[..., 1:]
    k = 2 / (w * w + jnp.sum(r * r, -1, keepdims=True))
    c = cross(r, a)
    return a - k * (w * c - cross(r, c))


def to_base(
    h: Float[Array, "*#batch attitude"], a: Float[Array, "*#batch vector"]
) -> Float[Array, "*#batch vector"]:
    """R(h) a: a vector of the body frame, seen from the base."""
    if h.shape[-1] <= 2:
        (c, s), x, z = _cosine_and_sine(h), a[..., :1], a[..., 1:]
        return jnp.concatenate([c * x + s * z, c * z - s * x], -1)
    w, r = h[..., :1], h[..., 1:]
    k = 2 / (w * w + jnp.sum(r * r, -1, keepdims=True))
    c = cross(r, a)
    return a + k * (w * c + cross(r, c))


def _series(x2, large, taylor):
    """`large(x)` where x^2 = x2 is not small, the polynomial `taylor` in x2 where it is."""
    small = x2 < _SMALL
    safe = jnp.where(small, 1.0, x2)
    poly = jnp.zeros_like(x2)
    for c in reversed(taylor):
        poly = poly * x2 + c
    return jnp.where(small, poly, large(jnp.sqrt(safe), safe))


def _sinc(x2):
    """sin(x)/x."""
    return _series(x2, lambda x, s: jnp.sin(x) / x, (1.0, -1 / 6, 1 / 120, -1 / 5040, 1 / 362880))


def _cosc(x2):
    """(1 - cos x)/x^2."""
    return _series(
        x2,
        lambda x, s: (1 - jnp.cos(x)) / s,
        (1 / 2, -1 / 24, 1 / 720, -1 / 40320, 1 / 3628800),
    )


def _sincc(x2):
    """(x - sin x)/x^3."""
    return _series(
        x2,
        lambda x, s: (x - jnp.sin(x)) / (s * x),
        (1 / 6, -1 / 120, 1 / 5040, -1 / 362880, 1 / 39916800),
    )


def quaternion_exp(a: Vector) -> Quaternion:
    """The quaternion of the rotation vector `a` [rad]."""
    half2 = jnp.sum(a * a, -1) / 4
    cos = 1 - half2 * _cosc(half2)
    return jnp.concatenate([cos[..., None], 0.5 * _sinc(half2)[..., None] * a], -1)


def rigid_motion_exp(v: Vector, u: Vector):
    """exp of the twist (v, u): displacement V(u) v and quaternion exp(u).

    V is the left Jacobian of SO(3): for constant strains (v, u) this is the exact pose of a
    rod of unit length, at any number of turns.
    """
    x2 = jnp.sum(u * u, -1)[..., None]
    c = cross(u, v)
    return v + _cosc(x2) * c + _sincc(x2) * cross(u, c), quaternion_exp(u)
