"""The inverse problem: which inputs bring the tip, or a marker, to where it should be."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Real

from softrod_jax.analysis.following_targets import Start, all_following
from softrod_jax.analysis.least_effort import least_effort
from softrod_jax.analysis.limits import Limits, checked_limits, spread_out
from softrod_jax.analysis.near_rest import check_smooth
from softrod_jax.analysis.targets import Known, Problem, answered, missed
from softrod_jax.bvp.collocation import Collocation
from softrod_jax.bvp.method import AbstractMethod
from softrod_jax.bvp.newton import NewtonOptions
from softrod_jax.foundation.compiling import compiled, on_cpu
from softrod_jax.foundation.precision import require_float64
from softrod_jax.foundation.results import RESULTS, raise_unless_successful
from softrod_jax.foundation.tracing import is_traced
from softrod_jax.rod.rotations import turn_between
from softrod_jax.scene.checks import checked_scene
from softrod_jax.scene.inputs import whole_number
from softrod_jax.scene.scene import Scene

# Which of the samples, by their distance, are starts until a search reaches its target. Neighbours
# often lead to the same place.
_OTHERS = 0, 1, 2, 4, 7, 11, 16, 22, 30, 40, 52, 66


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
    starts: int = 13,
    throw: bool = True,
) -> InverseSolution:
    """The inputs within `limits` that bring the tip to `target` with the least effort.

    - `target` [m], (3,) or (targets, 3); `quaternion` (w, x, y, z), (4,) or (targets, 4): an
      attitude that is asked for, too. `of`: "tip", or the name of a marker.
    - `limits`: for each kind of inputs that may be used, "tensions" [N], "pressures" [Pa] or
      "pulls" [m], its lowest and its highest values, a number or one for each actuator. Kinds
      without limits are left out. Where several inputs reach a target, those with the least sum of
      squares are taken, each in terms of the width of its limits.
    - `path`: the targets are places along a path; each search starts from the answer before. Else
      it starts from the nearest of `samples` equilibria under inputs all over the limits. Where
      that does not lead to the target, others of them are tried, `starts` in all (13 at most).
    - `method`: `Collocation(6)` if `None`, on its grid as given; `newton`: of each equilibrium.
    - `tolerance`: a target counts as reached within this many lengths of the rod and radians.
    - `throw`: raise `SolveError` where a target is not reached; else see `InverseSolution.result`.

    All targets are one compiled program. What is found is a local solution: other inputs, far from
    these, may reach a target with less effort, most of all where the first start did not lead to
    it, and the nearest point to one that is out of reach may be the nearest only of those around
    it. What is returned has been solved for once more as `solve_static` does it, from the unloaded
    rod.

    First derivatives, in both modes, by targets and the scene's numbers, are those of the local
    solution, with the inputs that are at a limit held there: effort decides where the target leaves
    a choice, and the nearest point follows a target that is out of reach. They are undefined where
    an input is about to come to a limit or to leave it, and where actuators lose a direction.
    Where the search has not ended at least effort, inputs follow with the least change. Limits are
    constants, and second derivatives refused.

    Raises `ValueError`
    for limits or targets of a wrong shape, for limits that a scene has no actuators for, and for
    friction and backlash, whose equilibria depend on the way to them.
    """
    require_float64("inverse")
    scene = checked_scene("inverse", scene)
    check_smooth("inverse", scene)
    low, high = checked_limits("inverse", scene, limits)
    places = ["tip", *(marker.name for marker in scene.markers or ())]
    if of not in places:
        raise ValueError(f"inverse: of={of!r} is not a marker of this scene; use one of {places}")
    target, quaternion = _checked_target(target, quaternion)
    samples = whole_number("inverse", "samples", samples)
    starts = whole_number("inverse", "starts", starts)
    method = (Collocation(6) if method is None else method).fitted(scene)
    one = target.ndim == 1
    if one:
        target = target[None]
        quaternion = None if quaternion is None else quaternion[None]
    problem = Problem(scene, low, high, jnp.asarray(tolerance, dtype=float), of, method, newton)
    # A search has no derivatives: its answers have.
    fixed, *aims = _still((problem, target, quaternion))
    known = fixed.solved(jnp.asarray(spread_out(samples, problem.rest.shape[0])))
    ends, iterations = _search(fixed, known, *aims, path, starts)
    x = ends.x
    traced = is_traced((problem, target, quaternion))
    if traced:
        x = all_following(problem, ends, target, quaternion)
    block = target.shape[0] if traced else samples
    found = _answers(problem, x, iterations, target, quaternion, block)
    if one:
        found = jax.tree.map(lambda x: x[0], found)
    if throw:
        found = raise_unless_successful(found.result, found, "inverse")
    return found


@compiled
def _search(problem: Problem, known: Known, target, quaternion, path: bool, starts: int):
    """Where the search for each target ends, a `Start` of its answer, and its iterations."""
    rest = problem.rest

    def away(target, quaternion):
        """Squared distances of the samples from a target."""
        r = jax.vmap(lambda pose: missed(pose, target, quaternion, problem.scene.length))
        return jnp.where(answered(known.result), jnp.sum(r(known.pose) ** 2, -1), jnp.inf)

    def sample(k):
        return known.x[k], jax.tree.map(lambda a: a[k], known.guess)

    def search(first, aim):
        """From one start after the other, until the target is reached."""
        size, order = 3 if quaternion is None else 6, jnp.argsort(away(*aim))

        def unreached(state):
            count, _, left, _ = state
            return (count <= len(others)) & ~(left <= problem.tolerance)

        def one(state):
            count, best, left, iterations = state
            another = sample(order[jnp.array([0, *others])[count]])
            x, guess = jax.tree.map(lambda a, b: jnp.where(count == 0, a, b), first, another)
            evaluate = lambda x, guess: problem.evaluate(x, guess, *aim)
            end = least_effort(evaluate, x, guess, rest, size, at_once=count > 0)
            now = jnp.where(end.at.solved, jnp.linalg.norm(end.at.r), jnp.inf)
            nearer = lambda a, b: jnp.where(now < left, a, b)
            best = jax.tree.map(nearer, (end.x, end.at.past), best)
            return count + 1, best, jnp.minimum(left, now), iterations + end.iterations

        others = [k for k in _OTHERS if k < known.x.shape[0]][: starts - 1]
        none = jnp.zeros((), jnp.int32)
        start = (none, first, jnp.array(jnp.inf), none)
        _, best, _, iterations = jax.lax.while_loop(unreached, one, start)
        return best, (Start(*best), iterations)

    nearest = lambda aim: sample(jnp.argmin(away(*aim)))
    aims = (target, quaternion)
    if path:
        first = nearest(jax.tree.map(lambda a: a[0], aims))
        return jax.lax.scan(search, first, aims)[1]
    one = lambda aim: search(nearest(aim), aim)[1]
    return jax.lax.map(one, aims) if on_cpu() else jax.vmap(one)(aims)


def _answers(problem: Problem, x, iterations, target, quaternion, block: int) -> InverseSolution:
    """What `solve_static` makes of the inputs at `x`, in blocks that samples have, too."""
    missing = -x.shape[0] % block
    rows = jnp.concatenate([x, jnp.repeat(x[-1:], missing, axis=0)]).reshape(-1, block, x.shape[1])
    solved = [problem.solved(part) for part in rows]
    joined = jax.tree.map(lambda *a: jnp.concatenate(a)[: x.shape[0]], *solved)
    pose, result, limit = joined.pose, joined.result, problem.tolerance
    distance = _length(pose.position - target)
    angle = jnp.zeros_like(distance)
    if quaternion is not None:
        sine = _length(jax.vmap(turn_between)(pose.quaternion, quaternion))
        angle = 2 * jnp.arcsin(jnp.minimum(sine, 1.0))
    reached = (distance <= limit * problem.scene.length) & (angle <= limit)
    result = jnp.where(answered(result) & ~reached, RESULTS.unreachable, result)
    result = jnp.where(answered(result), RESULTS.successful, result)
    return InverseSolution(
        **jax.vmap(problem.inputs)(x)._asdict(),
        position=pose.position,
        quaternion=pose.quaternion,
        distance=distance,
        angle=angle,
        effort=jnp.sum((x - problem.rest) ** 2, axis=-1),
        result=result.astype(jnp.int32),
        iterations=iterations,
    )


def _still(values):
    """The same, of which nothing is differentiated."""
    return jax.tree.map(lambda a: jax.lax.stop_gradient(a) if eqx.is_array(a) else a, values)


def _length(a: Float[Array, "*rows 3"]) -> Float[Array, "*rows"]:
    """Of each row; where it is zero, so is its derivative."""
    square = jnp.sum(a**2, axis=-1)
    return jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1.0)), 0.0)


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
