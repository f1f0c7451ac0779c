"""What is measured on a GPU: programs of one rod, their settings, and pieces of them."""

import contextlib
import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import launches
import numpy as np
from timing import FITTED, with_values

import softrod_jax as sr
from softrod_jax.bvp import block_sweep
from softrod_jax.bvp.equations import Equations
from softrod_jax.bvp.unloaded import unloaded_guess
from softrod_jax.foundation.compiling import compiler_options
from softrod_jax.rod.constitutive import compliance, recover_strain
from softrod_jax.rod.ode import pointwise_problem
from softrod_jax.rod.reduction import make_rod
from softrod_jax.rod.state import History, layout_of
from softrod_jax.scene.inputs import Inputs
from softrod_jax.stepping import inertial_continuation

DT, STEPS, RISE, MOST_TENSION, JUDGED = 20e-3, 50, 0.1, 0.3, 16
SIZES = 1, 16, 256, 1024, 4096, 16384, 65536
SCENE = sr.hybrid_robot(gravity=jnp.array([-9.81, 0.0, 0.0]))
VALUES = jnp.array([getattr(SCENE, name) for name in FITTED])
# A measurement ends after so many calls, or so many seconds.
CALLS, SECONDS = 5, 1.5


@dataclasses.dataclass(frozen=True)
class Setting:
    scheme: Any
    method: Any
    substeps: int = 1
    tolerance: float = sr.NewtonOptions().tolerance

    def __str__(self):
        scheme, method = self.scheme, self.method
        stages = (
            f", {scheme.stages} stages" if scheme.stages != sr.SDIRK(scheme.order).stages else ""
        )
        return (
            f"SDIRK({scheme.order}{stages}), {1e3 * DT / self.substeps:g} ms, {method.intervals} "
            f"intervals of order {method.order}, Newton's method to {self.tolerance:g}"
        )


# Of those that keep 1e-3 lengths on this robot the one with the fewest evaluations along the rod.
# Newton's method stops where what it leaves is a hundredth of the error in time.
COARSE = Setting(sr.SDIRK(3, stages=6), sr.Collocation(5), tolerance=1e-5)
DEFAULT = Setting(sr.SDIRK(3), sr.Collocation())
REFINED = Setting(sr.SDIRK(4), sr.Collocation(12), 8)
TIGHT = dataclasses.replace(COARSE, tolerance=DEFAULT.tolerance)
SETTINGS = {"1e-3 L": COARSE, "1e-3 L, solved tightly": TIGHT, "default": DEFAULT}
# Gradients of so many rods at a time: what reverse mode keeps of a motion fills the memory.
CHUNK = 16384


def tensions(count: int, steps: int):
    """(count, steps, 3) [N]; the first rods are the same whatever the count."""
    most = np.random.default_rng(0).uniform(size=(count, 1, 3)) * MOST_TENSION
    return most * np.minimum(1.0, np.arange(steps) * DT / RISE)[:, None]


# What is counted when a program runs, and the function that is called as often.
COUNTED = {"evaluations": "residual", "factorisations": "factorise", "attempts": "search_directly"}


# What is measured, of one rod: functions of (E, damping, drag) and tensions.


def equilibrium(values, tensions):
    scene = with_values(SCENE, values)
    solution = sr.solve_static(scene, tensions[-1], method=sr.Collocation(), throw=False)
    return solution.tip_position, solution.result, solution.stats["iterations"]


def motion(setting: Setting, values, tensions):
    moved = sr.simulate(
        with_values(SCENE, values),
        DT,
        tensions,
        scheme=setting.scheme,
        method=setting.method,
        substeps=setting.substeps,
        newton=sr.NewtonOptions(tolerance=setting.tolerance),
        max_time_error=jnp.inf,
        throw=False,
    )
    return moved.tip_positions, moved.result, jnp.sum(moved.stats["iterations"])


def reverse(setting: Setting, values, tensions):
    def loss(values):
        tips, *rest = motion(setting, values, tensions)
        return jnp.sum(tips**2), (tips, *rest)

    (_, (tips, *rest)), slope = jax.value_and_grad(loss, has_aux=True)(values)
    return tips, *rest, slope


def forward(setting: Setting, values, tensions):
    def tips(values):
        tips, *rest = motion(setting, values, tensions)
        return tips, (tips, *rest)

    slope, (tips, *rest) = jax.jacfwd(tips, has_aux=True)(values)
    return tips, *rest, slope


GRADIENTS = {"reverse gradient": reverse, "forward Jacobian": forward}
KINDS = {"motion": motion, **GRADIENTS}


def refined(count: int, steps: int):
    """Tips (count, steps + 1, 3) of the first rods."""
    arguments = jnp.tile(VALUES, (count, 1)), jnp.array(tensions(count, steps))
    run = jax.vmap(functools.partial(motion, REFINED))
    tips, codes, _ = jax.jit(run, compiler_options=compiler_options())(*arguments)
    if np.any(codes != 0):
        raise RuntimeError(f"refined: codes {np.unique(codes)}")
    return np.asarray(tips)


@contextlib.contextmanager
def counted(ticks: dict[str, int]):
    """Programs traced here add to `ticks` when they run: once a pass for a batch in lockstep."""

    def ticking(name, function):
        def tick():
            ticks[name] = ticks.get(name, 0) + 1

        @jax.custom_batching.custom_vmap
        def passing(x):
            jax.debug.callback(tick)
            return x

        @passing.def_vmap
        def _(size, batched, x):
            jax.debug.callback(tick)
            return x, batched[0]

        def call(*arguments, **options):
            passing(jnp.zeros(()))
            return function(*arguments, **options)

        return call

    places = list(zip((Equations, Equations, inertial_continuation), COUNTED.values(), COUNTED))
    before = [getattr(place, attribute) for place, attribute, _ in places]
    jax.clear_caches()
    try:
        for (place, attribute, name), old in zip(places, before):
            setattr(place, attribute, ticking(name, old))
        yield
    finally:
        for (place, attribute, _), old in zip(places, before):
            setattr(place, attribute, old)
        jax.clear_caches()


def passes_of(counts: dict[str, int], loop: launches.Loop) -> int | None:
    """How often a loop of unknown length passes in the whole call, by the function it is in.

    Attempts with factors in float64 are rare in a batch. How they share the passes of Newton's
    method is not known: they count as one each.
    """
    if loop.passes is not None:
        return None
    names = {"newton_with": "evaluations", "_in_single": "factorisations"}
    return counts.get(names.get(loop.name.split(".")[0], "attempts"))


def pieces_of_newton(method) -> dict[str, tuple[Callable, tuple]]:
    """{piece: (function of one rod, its arguments)}, in a step of 20 ms."""
    pull = jnp.array([0.1, 0.2, 0.3])
    rod = make_rod(SCENE, Inputs(pull), grid=method.grid(SCENE), spread_fronts=True)
    layout = layout_of(rod, dynamic=True)
    guess = unloaded_guess(layout, rod)
    c0 = jnp.array(1 / (0.22365 * DT))
    history = History(c0, -c0 * guess.strain, jnp.zeros_like(guess.strain))
    problem = Equations(method, layout, rod, history, guess.strain)
    U = problem.start(guess)
    noise = jax.random.normal(jax.random.key(0), U.along.shape)
    U = U._replace(along=U.along * (1 + 1e-3 * noise))
    F, factors = problem.residual(U), problem.factorise(U)
    of_method = lambda at, U: (U.along, at.rod, at.layout, at.history, at.guess)
    linear = method.linearise(*of_method(problem, U))
    slope = problem._tip(method.states(U.along, layout)).by_base_part
    defect, _ = method.condense(factors.inner, F.along)
    point = pointwise_problem(U.along[:, : layout.size], rod, layout, history)
    # As motions on a GPU have them.
    single = functools.partial(Equations.factorise, single=True)
    return {
        "evaluation": (lambda at, U: at.residual(U), (problem, U)),
        "correction": (lambda at, f, F: at.correct(f, F), (problem, factors, F)),
        "correction, factors in float32": (
            lambda at, f, F: at.correct(f, F),
            (problem, single(problem, U), F),
        ),
        "new factors in float32": (single, (problem, U)),
        "of it sweeps": (block_sweep.solve_sweeps, (factors.sweeps, defect, F.tip)),
        "new factors": (lambda at, U: at.factorise(U), (problem, U)),
        "of it Jacobians of intervals": (
            lambda at, U: method.linearise(*of_method(at, U))[:2],
            (problem, U),
        ),
        "of it compliances of points": (compliance, (point, guess.strain)),
        "of it block elimination": (
            block_sweep.factorise,
            (linear.left, linear.right, slope),
        ),
        "one inverse of an interval": (
            block_sweep.inverse,
            (linear.left[0] - 2 * linear.right[0],),
        ),
        "strains by minimisation (`Shooting`)": (recover_strain, (point, guess.strain)),
    }


def float32_refused() -> str:
    """What the package says to float32."""
    with jax.enable_x64(False):
        try:
            sr.solve_static(SCENE, [0.1, 0.1, 0.1], throw=False)
        except ValueError as error:
            return str(error)
    return "not refused"
