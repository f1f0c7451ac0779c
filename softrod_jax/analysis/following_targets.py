"""How the inputs of an answer follow targets and the scene.

By the implicit function theorem. An answer that reaches its target is where effort is least,

    x - x_rest + J^T mu = 0,   r(x) = 0,

for the inputs that are at no bound; the others stay where they are. With J = dr/dx of those, what
brings r back to zero, -J^+ dr, goes along the rows of J. Along its null space, if there is one, the
first condition says how x moves, and needs the curvature of r. An answer beside its target is where
|r|^2 is least, which J^T r = 0 says.

A search ends near such a point, within its tolerance. Newton's method goes to it; where that does
not lead back to where it began, effort was not least, and the inputs follow with the least change.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from softrod_jax.analysis.targets import Problem, missed
from softrod_jax.bvp.boundary_value import solve_boundary_value
from softrod_jax.bvp.method import Guess
from softrod_jax.foundation.compiling import on_cpu
from softrod_jax.rod.reduction import make_rod
from softrod_jax.rod.state import layout_of

# Of singular values, to the largest: smaller ones do not count. Of x: how near to a bound is at it,
# and how far Newton's method may go from the end of a search, and with how much change it ends.
_SMALL, _AT_BOUND, _FAR, _CLOSE, _STEPS = 1e-7, 1e-9, 0.05, 1e-6, 4


class Aim(NamedTuple):
    """What an answer depends on."""

    problem: Problem
    target: Float[Array, "3"]
    quaternion: Float[Array, "4"] | None


class Start(NamedTuple):
    """An answer, and states and strains of an equilibrium close to its own."""

    x: Float[Array, "m"]
    guess: Guess


class Bent(NamedTuple):
    """What is missed, and its first and second derivatives by the inputs."""

    r: Float[Array, "r"]
    J: Float[Array, "r m"]
    K: Float[Array, "r m m"]


class Local(NamedTuple):
    """The conditions of an answer: how x follows from a change of r and of d(mu.r)/dx.

    - `mu`: the multipliers; of an answer beside its target, r.
    - `back`, (m, r): what brings r back to zero; `beside`, (r, m): J, of an answer beside its
      target. One of the two is zero.
    - `null`, (m, m): onto the directions in which effort decides, or the distance; `H`: the second
      derivative of what is minimised, and `curved` its inverse in these directions.
    """

    mu: Float[Array, "r"]
    back: Float[Array, "m r"]
    beside: Float[Array, "r m"]
    null: Float[Array, "m m"]
    H: Float[Array, "m m"]
    curved: Float[Array, "m m"]

    def step(self, r: Float[Array, "r"], g: Float[Array, "m"]) -> Float[Array, "m"]:
        """The change of x that takes away these changes of the two conditions."""
        along = -self.back @ r
        return along - self.curved @ (self.null @ (g + r @ self.beside + self.H @ along))


def residual(aim: Aim, guess: Guess, x: Float[Array, "m"]) -> Float[Array, "r"]:
    """What is missed under the inputs at `x`; a step of Newton's method from `guess` or two."""
    problem = aim.problem
    scene, method = problem.scene, problem.method
    rod = make_rod(scene, problem.inputs(x), dynamic=False, grid=method.grid(scene))
    layout = layout_of(rod, dynamic=False)
    solved = solve_boundary_value(method, layout, problem.newton, rod, None, guess)
    pose = problem.pose(x, solved.fields)
    return missed(pose, aim.target, aim.quaternion, scene.length)


def slope(aim: Aim, guess: Guess, x: Float[Array, "m"]):
    """J, (r, m), in forward mode, as inputs are few; and r."""

    def twice(x):
        r = residual(aim, guess, x)
        return r, r

    return jax.jacfwd(twice, has_aux=True)(x)


def all_following(
    problem: Problem,
    found: Start,
    target: Float[Array, "targets 3"],
    quaternion: Float[Array, "targets 4"] | None,
) -> Float[Array, "targets m"]:
    """The answers of a search, with their derivatives by the targets and the scene."""

    return _all(Aim(problem, target, quaternion), jax.lax.stop_gradient(found))


@eqx.filter_custom_jvp
def _all(aims: Aim, found: Start) -> Float[Array, "targets m"]:
    return found.x


@_all.def_jvp
def _all_jvp(primals, tangents):
    aims, found = primals
    moving, still, dot = _moving(aims, tangents[0])

    def every(moving):
        problem, *each = eqx.combine(moving, still)
        one = lambda given: _following(Aim(problem, *given[0]), given[1])
        return jax.lax.map(one, (each, found)) if on_cpu() else jax.vmap(one)((each, found))

    # Points are constants here, which a second derivative would take them for.
    once = _once(eqx.filter(primals, eqx.is_inexact_array))
    return found.x, (1 + once) * jax.jvp(every, (moving,), (dot,))[1]


def _moving(aim: Aim, dot):
    """What of it changes, what does not, and the change, as `jax.jvp` takes them."""
    absent = lambda t: t is None
    moving = jax.tree.map(lambda t, a: None if t is None else a, dot, aim, is_leaf=absent)
    still = jax.tree.map(lambda t, a: a if t is None else None, dot, aim, is_leaf=absent)
    return moving, still, dot


@eqx.filter_custom_jvp
def _following(aim: Aim, found: Start) -> Float[Array, "m"]:
    return found.x


@_following.def_jvp
def _following_jvp(primals, tangents):
    aim, found = primals
    moving, still, dot = _moving(aim, tangents[0])
    point, local = _conditions(aim, found)

    def conditions(moving):
        J, r = slope(eqx.combine(moving, still), found.guess, point)
        return r, local.mu @ J

    return found.x, local.step(*jax.jvp(conditions, (moving,), (dot,))[1])


@jax.custom_jvp
def _once(values):
    """Zero; differentiated, it raises."""
    return jnp.zeros(())


@_once.defjvp
def _refuse(primals, tangents):
    raise ValueError(
        "inverse: has first derivatives only; differentiate solve_static at the inputs it finds"
    )


class _Newton(NamedTuple):
    """`x` is where `local` is of, until a step of some length leads on."""

    x: Float[Array, "m"]
    local: Local
    reached: Bool[Array, ""]
    length: Float[Array, ""]
    count: Int[Array, ""]


def _conditions(aim: Aim, found: Start) -> tuple[Float[Array, "m"], Local]:
    """The point that an answer stands for, and its conditions there."""
    first, rest, m = found.x, aim.problem.rest, found.x.shape[0]
    free = (first > _AT_BOUND) & (first < 1 - _AT_BOUND)

    def bent(x) -> Bent:
        def first(x):
            J, r = slope(aim, found.guess, x)
            return J, Bent(r, J, jnp.zeros(()))

        K, known = jax.jacfwd(first, has_aux=True)(x)
        return known._replace(K=K)

    def one(state: _Newton) -> _Newton:
        at = bent(state.x)
        close = jnp.linalg.norm(at.r.reshape(-1, 3), axis=1) <= aim.problem.tolerance
        reached = jnp.where(state.count == 0, jnp.all(close), state.reached)
        from_rest = jnp.where(free, state.x - rest, 0.0)
        local = _local(at, from_rest, free, reached)
        g = jnp.where(reached & free, from_rest + local.mu @ at.J, 0.0)
        step = local.step(at.r, g)
        length = jnp.max(jnp.abs(step))
        x = jnp.where(length > _CLOSE, state.x + step, state.x)
        return _Newton(x, local, reached, length, state.count + 1)

    def goes_on(state: _Newton):
        near = jnp.max(jnp.abs(state.x - first)) < _FAR
        return (state.count == 0) | ((state.length > _CLOSE) & near & (state.count < _STEPS))

    size, square = 3 if aim.quaternion is None else 6, jnp.zeros((m, m))
    flat = jnp.zeros((size, m))
    nothing = Local(jnp.zeros(size), flat.T, flat, square, square, square)
    start = _Newton(first, nothing, jnp.array(False), jnp.zeros(()), jnp.zeros((), jnp.int32))
    end = jax.lax.while_loop(goes_on, one, start)
    inside = jnp.all((end.x > -_AT_BOUND) & (end.x < 1 + _AT_BOUND))
    good = (end.length <= _CLOSE) & inside
    local = end.local._replace(curved=jnp.where(good, end.local.curved, 0.0))
    return jnp.where(good, end.x, first), local


def _local(at: Bent, from_rest, free, reached) -> Local:
    """The conditions at a point, in the inputs that are `free`."""
    J = jnp.where(free, at.J, 0.0)
    U, s, V = jnp.linalg.svd(J, full_matrices=False)
    counts = s > _SMALL * jnp.max(s)
    back = V.T @ (jnp.where(counts, 1 / jnp.where(counts, s, 1.0), 0.0)[:, None] * U.T)
    mu = jnp.where(reached, -back.T @ from_rest, at.r)
    # Beside the target all that is free follows from J^T r = 0, and nothing brings r back.
    H = jnp.where(reached, jnp.eye(J.shape[1]), J.T @ J) + jnp.tensordot(mu, at.K, 1)
    H = jnp.where(free[:, None] & free, H, 0.0)
    null = jnp.diag(free * 1.0) - jnp.where(reached, (V.T * counts) @ V, 0.0)
    values, vectors = jnp.linalg.eigh(null @ H @ null)
    counts = jnp.abs(values) > _SMALL * jnp.max(jnp.abs(H))
    inverses = jnp.where(counts, 1 / jnp.where(counts, values, 1.0), 0.0)
    curved = (vectors * inverses) @ vectors.T
    back, beside = jnp.where(reached, back, 0.0), jnp.where(reached, 0.0, J)
    return Local(mu, back, beside, null, H, curved)
