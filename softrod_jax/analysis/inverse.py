"""The inverse problem: which inputs bring the tip, or a marker, to where it should be."""

from collections.abc import Mapping

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, Int, Real

from softrod_jax.analysis.least_effort import Evaluated, least_effort
from softrod_jax.analysis.near_rest import check_smooth
from softrod_jax.bvp.collocation import Collocation
from softrod_jax.bvp.method import AbstractMethod
from softrod_jax.bvp.newton import NewtonOptions
from softrod_jax.foundation.compiling import compiled, on_cpu
from softrod_jax.foundation.precision import require_float64
from softrod_jax.foundation.results import RESULTS, raise_unless_successful
from softrod_jax.rod.rotations import quaternion_product
from softrod_jax.scene.checks import checked_scene
from softrod_jax.scene.inputs import KINDS, Inputs, whole_number
from softrod_jax.scene.scene import Scene
from softrod_jax.statics import solve_from

Limits = Mapping[str, tuple]

# Which of the samples, the nearest first, are starts until a search reaches its target. Neighbours
# lead to the same place.
_STARTS = np.array([0, 1, 2, 4, 7, 11, 16, 22, 30, 40, 52, 66])


class InverseSolution(eqx.Module):
    """The inputs found, for one target or, with a first axis, for many.

    - `tensions` [N], `pressures` [Pa], `pulls` [m]: of those kinds that have limits, else `None`.
    - `position` [m], (3,), and `quaternion`, (4,): of what is to be brought to the target, in the
      equilibrium under these inputs.
    - `distance` [m]: how far that is from the target; `angle` [rad], zero where no attitude is
      asked for. `effort`: sum of the squares of inputs, each in terms of the width of its limits,
      from what is nearest to zero.
    - `result`: 0 where the target is reached; `RESULTS.unreachable` where these are the inputs of
      the nearest point found; else that of the equilibrium.
    - `iterations`: of the search.
    """

    tensions: Float[Array, "*targets by_tension"] | None
    pressures: Float[Array, "*targets chambers"] | None
    pulls: Float[Array, "*targets by_length"] | None
    position: Float[Array, "*targets 3"]
    quaternion: Float[Array, "*targets 4"]
    distance: Float[Array, "*targets"]
    angle: Float[Array, "*targets"]
    effort: Float[Array, "*targets"]
    result: Int[Array, "*targets"]
    iterations: Int[Array, "*targets"]


def inverse(
    scene: Scene,
    target: Real[Array | np.ndarray, "*targets 3"],
    limits: Limits,
    *,
    quaternion: Real[Array | np.ndarray, "*targets 4"] | None = None,
    of: str = "tip",
    path: bool = False,
    method: AbstractMethod | None = None,
    newton: NewtonOptions = NewtonOptions(),
    tolerance: float = 1e-5,
    samples: int = 256,
    throw: bool = True,
) -> InverseSolution:
    """The inputs within `limits` that bring the tip to `target` with the least effort.

    - `target` [m], (3,) or (targets, 3); `quaternion` (w, x, y, z), (4,) or (targets, 4): an
      attitude that is asked for, too. `of`: "tip", or the name of a marker.
    - `limits`: for each kind of inputs that may be used, "tensions" [N], "pressures" [Pa] or
      "pulls" [m], its lowest and its highest values, a number or one for each actuator. Kinds
      without limits are left out. Where several inputs reach a target, those with the least sum of
      squares are taken, each in terms of the width of its limits.
    - `path`: the targets are places along a path; each search starts from the answer before.
      Else, and where that does not reach the target, from the nearest of `samples` equilibria under
      inputs all over the limits, one after the other.
    - `method`: `Collocation(6)` if `None`, on its grid as given; `newton`: of each equilibrium.
    - `tolerance`: a target counts as reached within this many lengths of the rod and radians.
    - `throw`: raise `SolveError` where a target is not reached; else see `InverseSolution.result`.

    All targets are one compiled program. What is found is a local solution: other inputs, far from
    these, may reach a target with less effort, and the nearest point to one that is out of reach
    may be the nearest only of those around it. What is returned has been solved for once more as
    `solve_static` does it, from the unloaded rod.

    Works under `jit` and `vmap`; it has no derivatives, and says so: use `actuation_jacobian` at
    the answer. Raises `ValueError` for limits or targets of a wrong shape, for limits that a scene
    has no actuators for, and for friction and backlash, whose equilibria depend on the way to them.
    """
    require_float64("inverse")
    scene = checked_scene("inverse", scene)
    check_smooth("inverse", scene)
    low, high = _checked_limits(scene, limits)
    places = ["tip", *(marker.name for marker in scene.markers or ())]
    if of not in places:
        raise ValueError(f"inverse: of={of!r} is not a marker of this scene; use one of {places}")
    target, quaternion = _checked_target(target, quaternion)
    samples = whole_number("inverse", "samples", samples)
    method = (Collocation(6) if method is None else method).fitted(scene)
    one = target.ndim == 1
    if one:
        target = target[None]
        quaternion = None if quaternion is None else quaternion[None]
    without_derivatives((scene, low, high, target, quaternion))
    problem = Problem(scene, low, high, jnp.asarray(tolerance, dtype=float), of, method, newton)
    found = _inverse(problem, target, quaternion, path, samples)
    if one:
        found = jax.tree.map(lambda x: x[0], found)
    if throw:
        found = raise_unless_successful(found.result, found, "inverse")
    return found


class Problem(eqx.Module):
    """What all targets share; `tolerance` in lengths of the rod and radians."""

    scene: Scene
    low: Inputs
    high: Inputs
    tolerance: Float[Array, ""]
    of: str = eqx.field(static=True)
    method: AbstractMethod = eqx.field(static=True)
    newton: NewtonOptions

    @property
    def rest(self) -> Float[Array, "m"]:
        """Where effort is zero, in parts of the limits."""
        low, high = ravel_pytree(self.low)[0], ravel_pytree(self.high)[0]
        return (jnp.clip(0.0, low, high) - low) / (high - low)

    def inputs(self, x: Float[Array, "m"]) -> Inputs:
        """Those at parts `x` of the limits."""
        low, as_inputs = ravel_pytree(self.low)
        return as_inputs(low + x * (ravel_pytree(self.high)[0] - low))

    def solve(self, x, past=None):
        """The equilibrium there, after `past`."""
        return solve_from(self.scene, self.inputs(x), past, None, self.method, self.newton)

    def residual(self, x, past, target, quaternion):
        """Distances in lengths of the rod, and twice the sines of half the angles."""
        solution = self.solve(x, past)
        pose = solution.markers[self.of]
        r = (pose.position - target) / self.scene.length
        if quaternion is not None:
            r = jnp.concatenate([r, 2 * _turn(pose.quaternion, quaternion)])
        return r, (r, _answered(solution.result), solution.reached)


def _answered(result):
    """Whether there is an equilibrium, be it on too coarse a grid."""
    return (result == RESULTS.successful) | (result == RESULTS.inaccurate)


def _turn(h, target):
    """The vector of the quaternion from one attitude to the other, the short way."""
    turn = quaternion_product(h, target * jnp.array([1.0, -1.0, -1.0, -1.0]))
    return jnp.where(turn[0] < 0, -turn[1:], turn[1:])


@compiled
def _inverse(problem: Problem, target, quaternion, path: bool, samples: int):
    rest = problem.rest
    each = lambda f, xs: jax.lax.map(f, xs) if on_cpu() else jax.vmap(f)(xs)
    # All over the limits, the same in every call (a Kronecker sequence).
    x = jnp.asarray(_spread_out(samples, rest.shape[0]))
    known = each(problem.solve, x)
    ok = _answered(known.result)

    def starts(target, quaternion):
        """Where to start, the nearest first."""
        pose = known.markers[problem.of]
        away = jnp.sum(((pose.position - target) / problem.scene.length) ** 2, -1)
        if quaternion is not None:
            turns = jax.vmap(_turn, (0, None))(pose.quaternion, quaternion)
            away = away + 4 * jnp.sum(turns**2, -1)
        chosen = jnp.argsort(jnp.where(ok, away, jnp.inf))[_STARTS[_STARTS < samples]]
        return x[chosen], jax.tree.map(lambda a: a[chosen], known.reached)

    def search(candidates, aim):
        """From one start after the other, until the target is reached."""
        size = 3 if quaternion is None else 6

        def evaluate(x, past):
            J, (r, solved, reached) = jax.jacfwd(problem.residual, has_aux=True)(x, past, *aim)
            return Evaluated(r, J, solved, reached)

        def unreached(state):
            k, best, left, _ = state
            return (k < candidates[0].shape[0]) & ~(left <= problem.tolerance)

        def one(state):
            k, best, left, iterations = state
            end = least_effort(evaluate, *jax.tree.map(lambda a: a[k], candidates), rest, size)
            now = jnp.where(end.at.solved, jnp.linalg.norm(end.at.r), jnp.inf)
            kept = jax.tree.map(
                lambda a, b: jnp.where(now < left, a, b), (end.x, end.at.past), best
            )
            return k + 1, kept, jnp.minimum(left, now), iterations + end.iterations

        first = jax.tree.map(lambda a: a[0], candidates)
        none = jnp.zeros((), jnp.int32)
        _, best, _, iterations = jax.lax.while_loop(
            unreached, one, (none, first, jnp.array(jnp.inf), none)
        )
        return best, _answer(problem, best[0], iterations, *aim)

    aims = (target, quaternion)
    if not path:
        return each(lambda aim: search(starts(*aim), aim)[1], aims)

    def follow(before, aim):
        beside = lambda a, b: jnp.concatenate([a[None], b])
        return search(jax.tree.map(beside, before, starts(*aim)), aim)

    first = jax.tree.map(lambda a: a[0], starts(*jax.tree.map(lambda a: a[0], aims)))
    return jax.lax.scan(follow, first, aims)[1]


def _answer(problem: Problem, x, iterations, target, quaternion) -> InverseSolution:
    solution = problem.solve(x)
    pose = solution.markers[problem.of]
    distance = jnp.linalg.norm(pose.position - target)
    angle = jnp.zeros(())
    if quaternion is not None:
        sine = jnp.linalg.norm(_turn(pose.quaternion, quaternion))
        angle = 2 * jnp.arcsin(jnp.minimum(sine, 1.0))
    limit = problem.tolerance
    reached = (distance <= limit * problem.scene.length) & (angle <= limit)
    result = jnp.where(_answered(solution.result) & ~reached, RESULTS.unreachable, solution.result)
    return InverseSolution(
        **problem.inputs(x)._asdict(),
        position=pose.position,
        quaternion=pose.quaternion,
        distance=distance,
        angle=angle,
        effort=jnp.sum((x - problem.rest) ** 2),
        result=result.astype(jnp.int32),
        iterations=iterations,
    )


def _spread_out(count: int, m: int) -> np.ndarray:
    """Points in [0, 1]^m, (count, m): multiples of powers of a root of x^(m+1) = x + 1."""
    root = 1.5
    for _ in range(60):
        root = (1 + root) ** (1 / (m + 1))
    return (0.5 + np.arange(1, count + 1)[:, None] * root ** -np.arange(1.0, m + 1)) % 1.0


@jax.custom_jvp
def without_derivatives(values):
    """Nothing; differentiated, it raises."""
    return jnp.zeros(())


@without_derivatives.defjvp
def _refuse(primals, tangents):
    raise ValueError(
        "inverse: has no derivatives; take actuation_jacobian at the inputs that it finds"
    )


def _checked_limits(scene: Scene, limits: Limits) -> tuple[Inputs, Inputs]:
    kinds = {kind.name: kind for kind in KINDS}
    if not isinstance(limits, Mapping) or not limits:
        offered = ", ".join(f'"{name}"' for name, kind in kinds.items() if kind.count(scene))
        raise ValueError(f"inverse: limits={limits!r}; a dictionary is needed, with {offered}")
    low, high = {}, {}
    for name, given in limits.items():
        kind = kinds.get(name)
        if kind is None or not kind.count(scene):
            raise ValueError(f"inverse: limits for {name!r}, of which the scene has none")
        count = kind.count(scene)
        try:
            pair = [jnp.asarray(x, dtype=float) for x in given]
            lowest, highest = (jnp.broadcast_to(x, (count,)) for x in pair)
        except (TypeError, ValueError):
            raise ValueError(
                f"inverse: limits[{name!r}] = {given!r}; a lowest and a highest value are needed, "
                f"each a number or {count} of them"
            ) from None
        if not np.all(np.asarray(highest) > np.asarray(lowest)) or not np.all(
            np.isfinite([lowest, highest])
        ):
            raise ValueError(f"inverse: limits[{name!r}] = {given!r}; expected lowest < highest")
        if np.min(lowest) < kind.at_least:
            raise ValueError(
                f"inverse: limits[{name!r}] = {given!r}; {kind.reason}: at least {kind.at_least:g}"
            )
        low[name], high[name] = lowest, highest
    return Inputs(**low), Inputs(**high)


def _checked_target(target, quaternion):
    target = jnp.asarray(target, dtype=float)
    if target.ndim not in (1, 2) or target.shape[-1] != 3:
        raise ValueError(f"inverse: target has shape {target.shape}; expected (3,) or (targets, 3)")
    if quaternion is None:
        return target, None
    quaternion = jnp.asarray(quaternion, dtype=float)
    expected = (*target.shape[:-1], 4)
    if quaternion.shape != expected:
        raise ValueError(f"inverse: quaternion has shape {quaternion.shape}; expected {expected}")
    return target, quaternion / jnp.linalg.norm(quaternion, axis=-1, keepdims=True)
