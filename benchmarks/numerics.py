"""What each part of the numerics does, by leaving it out: errors and counts, no times.

    python benchmarks/numerics.py [--write-docs]

The robot of `softrod_jax.hybrid_robot`, 0.1 m long. The tables are those of the page on numerics in
`docs/pages/numerics.md`, and go there with --write-docs. Parts are left out by patches, as a
user could not. Some minutes on one core, most of it compiling.
"""

from contextlib import ExitStack, contextmanager
from unittest import mock

import jax
import jax.numpy as jnp
import numpy as np
from report import machine, publish, table

import softrod_jax as sr
from softrod_jax.bvp import newton
from softrod_jax.bvp.block_sweep import factorise, solve_sweeps
from softrod_jax.bvp.boundary_value import search_directly
from softrod_jax.bvp.equations import Equations
from softrod_jax.bvp.unloaded import unloaded_guess
from softrod_jax.rod import constants as rod
from softrod_jax.rod.state import History, Layout
from softrod_jax.stepping import moving_rod

L = 0.1
DURATION, FINEST = 0.4, 2.5e-3  # s


def across():
    """The robot under gravity across it."""
    return sr.hybrid_robot(gravity=jnp.array([-9.81, 0.0, 0.0]))


@contextmanager
def patched(*patches):
    """Programs that are compiled inside have the patches, and none that is compiled outside."""
    with ExitStack() as stack:
        for patch in patches:
            stack.enter_context(patch)
        jax.clear_caches()
        yield
    jax.clear_caches()


def short(x) -> str:
    return f"{float(x):.1e}".replace("e-0", "e-").replace("e+0", "e+")


def farthest(a, b):
    return float(np.max(np.linalg.norm(np.asarray(a) - np.asarray(b), axis=-1)))


# --- linear systems ------------------------------------------------------------------------------


def sweeps() -> str:
    """The linear system of one step, by the sweeps and by products of transfer matrices."""
    method, layout = sr.Collocation(), Layout(attitude=True, dynamic=True)
    moving = rod.make_rod(across(), grid=method.grid(across()))
    guess = unloaded_guess(layout, moving)
    rhs = np.random.default_rng(0).normal(size=(method.intervals, layout.size))
    rows = []
    for dt in (0.1, 0.05, 0.02, 0.01, 5e-3, 1e-3, 1e-4):
        history = History(jnp.array(1 / dt), -guess.strain / dt, jnp.zeros_like(guess.strain))
        equations = Equations(method, layout, moving, history, guess.strain)
        U = equations.start(guess)
        linear = method.linearise(U.along, *equations._problem(U))
        units = equations.scale(U).along[: layout.size]
        left, right = (np.asarray(B * units / units[:, None]) for B in linear[:2])
        slope = np.zeros((6, layout.base_size))
        exact = dense(left, right, rhs)
        swept = solve_sweeps(factorise(left, right, slope), rhs, jnp.zeros(6))
        product, growth = products(left, right, rhs)
        off = [short(np.linalg.norm(x - exact) / np.linalg.norm(exact)) for x in (swept, product)]
        rows.append([f"{1e3 * dt:g}", short(growth), *off])
    return table(["dt [ms]", "growth along the rod", "sweeps", "products"], rows)


def dense(left, right, rhs):
    """All unknowns at once, with pivoting over the whole matrix."""
    m, n = rhs.shape
    A, b = np.zeros(((m + 1) * n, (m + 1) * n)), np.zeros((m + 1) * n)
    for k in range(m):
        A[k * n : (k + 1) * n, k * n : (k + 2) * n] = np.hstack([left[k], right[k]])
        b[k * n : (k + 1) * n] = -rhs[k]
    A[m * n : m * n + n - 6, : n - 6] = np.eye(n - 6)  # nothing moves at the clamp,
    A[-6:, -6:] = np.eye(6)  # no wrench changes at the tip
    return np.linalg.solve(A, b).reshape(m + 1, n)


def products(left, right, rhs):
    """The wrench at the clamp from that at the tip, by products along the rod; their growth."""
    n = rhs.shape[1]
    A = -np.linalg.solve(right, left)
    b = -np.linalg.solve(right, rhs[..., None])[..., 0]
    P, c = np.eye(n), np.zeros(n)
    for A_k, b_k in zip(A, b, strict=True):
        P, c = A_k @ P, A_k @ c + b_k
    y = np.concatenate([np.zeros(n - 6), -np.linalg.solve(P[-6:, -6:], c[-6:])])
    answer = [y]
    for A_k, b_k in zip(A, b, strict=True):
        answer.append(A_k @ answer[-1] + b_k)
    return np.array(answer), np.linalg.norm(P, 2)


# --- time ----------------------------------------------------------------------------------------


def gravity_step(dt, **options):
    """The motion over 0.4 s under gravity that acts from t = 0: tips, and what `stats` says.

    Every dt takes as many steps, so that there is one program; what is too much is cut off.
    """
    count, as_given = round(DURATION / FINEST), dict(substeps=1, max_time_error=np.inf)
    motion = sr.simulate(across(), dt, steps=count, **as_given, **options)
    steps = round(DURATION / dt)
    stats = {name: np.asarray(x)[:steps] for name, x in motion.stats.items() if np.ndim(x)}
    return np.asarray(motion.tip_positions)[: steps + 1], stats


def error(tips, fine, dt) -> float:
    return farthest(tips, fine[:: round(dt / FINEST)])


def restarts(fine) -> str:
    """BDF-alpha with and without the step of backward Euler after a jump."""
    usual = sr.BDFAlpha.coefficients
    never = lambda self, dt, restart: usual(self, dt, jnp.zeros_like(restart))
    rows = []
    for alpha in (-0.2, -0.45):
        for name, patches in (
            ("no", [mock.patch.object(sr.BDFAlpha, "coefficients", never)]),
            ("yes", []),
        ):
            with patched(*patches):
                steps = (10e-3, 5e-3, 2.5e-3)
                scheme = sr.BDFAlpha(alpha)
                errors = [error(gravity_step(dt, scheme=scheme)[0], fine, dt) for dt in steps]
            fall = f"{errors[-2] / errors[-1]:.1f}"
            rows.append([f"`BDFAlpha({alpha:g})`", name, *map(short, errors), fall])
    header = ["scheme", "restart", "dt = 10 ms", "5 ms", "2.5 ms", "last two, ratio"]
    return table(header, rows)


def time_estimates(fine) -> str:
    """The estimated error in time beside the true one, of motions of 0.4 s."""
    rows = []
    for scheme, name, steps in (
        (sr.SDIRK(3), "SDIRK(3)", (20e-3, 10e-3)),
        (sr.BDFAlpha(-0.45), "BDFAlpha(-0.45)", (20e-3, 10e-3, 5e-3)),
    ):
        for dt in steps:
            tips, stats = gravity_step(dt, scheme=scheme)
            estimate, true = L * stats["time_error"][-1], error(tips, fine, dt)
            row = [f"`{name}`", f"{1e3 * dt:g}", short(estimate), short(true)]
            rows.append([*row, f"{estimate / true:.1f}"])
    return table(["scheme", "dt [ms]", "estimate [m]", "error [m]", "ratio"], rows)


# --- Newton's method -----------------------------------------------------------------------------


@contextmanager
def counted():
    """Counts Jacobians with their factors, as they are made while programs run."""
    count, usual = [0], Equations.factorise

    def tell(x):
        count[0] += 1
        return np.asarray(x)

    def counting(self, U, safe=None):
        # What depends on the count is computed each time, and once.
        U = jax.pure_callback(tell, jax.ShapeDtypeStruct(U.shape, U.dtype), U)
        return usual(self, U, safe)

    with patched(mock.patch.object(Equations, "factorise", counting)):
        yield count


def reuse() -> str:
    """Evaluations and Jacobians of a step, where factors serve on and where they do not."""
    variants = (
        ("none: new ones for every correction", {"_REUSE": 0.0}, 0.0),
        ("within a solve", {}, 0.0),
        ("and from one solve to the next", {}, moving_rod._REUSE),
    )
    rows = []
    for name, constants, reuse in variants:
        patches = [mock.patch.object(newton, k, v) for k, v in constants.items()]
        with patched(*patches, mock.patch.object(moving_rod, "_REUSE", reuse)), counted() as count:
            row = [name]
            for dt in (10e-3, 2.5e-3):
                count[0] = 0
                steps = round(DURATION / FINEST)  # all of them count, also those cut off
                stats = sr.simulate(across(), dt, steps=steps, substeps=1).stats
                evaluations = float(np.mean(stats["iterations"]))
                row += [f"{evaluations:.1f}", f"{count[0] / steps:.1f}"]
            rows.append(row)
    header = ["factors serve", "dt = 10 ms: evaluations a step", "Jacobians", "2.5 ms: evaluations"]
    return table([*header, "Jacobians"], rows)


def stopping(fine) -> str:
    """What a looser tolerance of Newton's method saves, and what it costs."""
    rows, dt = [], 10e-3
    for tolerance in (1e-10, 1e-6, 1e-4):
        tips, stats = gravity_step(dt, newton=sr.NewtonOptions(tolerance))
        exact = tips if not rows else exact
        evaluations = float(np.mean(stats["iterations"]))
        moved = short(farthest(tips, exact)) if rows else "–"
        off = short(error(tips, fine, dt))
        rows.append([short(tolerance), f"{evaluations:.1f}", moved, off])
    header = ["tolerance", "evaluations a step", "moves the tip by [m]", "error of the motion [m]"]
    return table(header, rows)


# --- hard loads ----------------------------------------------------------------------------------


def hard_jumps() -> str:
    """Of 40 jumps of a tension, 0.05 to 2 N, how many are solved with parts left out."""

    def plainly(equations, options, U, before):
        return search_directly(equations, options, U, before.reused)

    variants = [
        ("Newton's method alone", [mock.patch.object(moving_rod, "search_by_inertia", plainly)]),
        ("no artificial viscosity", [mock.patch.object(rod, "_FRONT_VISCOSITY", 1e-12)]),
        ("everything", []),
    ]
    rows = []
    for name, patches in variants:
        with patched(*patches):
            program = jax.jit(jax.vmap(jump, (None, 0)))
            solved = [int(np.sum(program(dt, JUMPS) == 0)) for dt in JUMP_STEPS]
        rows.append([name, *map(str, solved)])
    return table(["solver", *(f"dt = {1e3 * dt:g} ms" for dt in JUMP_STEPS)], rows)


JUMPS, JUMP_STEPS = np.linspace(0.05, 2.0, 40), (15e-3, 5e-3, 1e-3, 2e-4)


def jump(dt, pull):
    """The code of ten steps in which a tension jumps at once to `pull`."""
    tensions = jnp.zeros((10, 3)).at[:, 0].set(pull)
    motion = sr.simulate(sr.hybrid_robot(), dt, tensions, max_time_error=jnp.inf, throw=False)
    return motion.result


# --- errors along the rod ------------------------------------------------------------------------


def grid_estimates() -> str:
    """The estimated error along the rod beside the true one, in statics."""
    pull, rows = (0.3, 0.0, 0.0), []
    fine = sr.solve_static(across(), pull, method=sr.Collocation(48)).tip_position
    for order, intervals in ((4, (8, 16)), (6, (4, 6, 12))):
        for count in intervals:
            method = sr.Collocation(count, order=order)
            solution = sr.solve_static(across(), pull, method=method, throw=False)
            true = farthest(solution.tip_position, fine)
            estimate = L * solution.stats["error"]
            row = [f"`Collocation({count}, order={order})`", short(estimate), short(true)]
            rows.append([*row, f"{estimate / true:.1f}"])
    return table(["grid", "estimate [m]", "error [m]", "ratio"], rows)


def main():
    publish("sweeps", "numerics.md", sweeps())
    fine, _ = gravity_step(FINEST, scheme=sr.SDIRK(4))
    publish("time estimates", "numerics.md", time_estimates(fine))
    publish("stopping", "numerics.md", stopping(fine))
    publish("restarts", "numerics.md", restarts(fine))
    publish("reuse", "numerics.md", reuse())
    publish("hard jumps", "numerics.md", hard_jumps())
    publish("grid estimates", "numerics.md", grid_estimates())
    print(machine())


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    main()
