"""What each part of the numerics does, by leaving it out: errors and counts, no times.

    python benchmarks/numerics.py [--write-readme]

The robot of `softrod_jax.hybrid_robot`, 0.1 m long. The tables are those of the page on numerics in
`docs/pages/numerics.md`, and go there with --write-readme. Parts are left out by patches, as a
user could not. Some minutes on one core, most of it compiling.
"""

from contextlib import ExitStack, contextmanager
from pathlib import Path
from unittest import mock

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from report import machine, publish, table

import softrod_jax as sr
from softrod_jax import marching, newton, rod, statics
from softrod_jax.block_sweep import factorise, solve_sweeps
from softrod_jax.boundary_value import Equations, search_directly
from softrod_jax.rod_ode import History, Layout
from softrod_jax.scene import as_arrays

PAGE = Path(__file__).parents[1] / "docs" / "pages" / "numerics.md"
L = 0.1


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
    moving = rod.make_rod(across())
    guess = statics.unloaded_guess(method, layout, moving)
    rhs = np.random.default_rng(0).normal(size=(method.intervals, layout.size))
    rows = []
    for dt in (0.1, 0.05, 0.02, 0.01, 5e-3, 1e-3, 1e-4):
        history = History(jnp.array(1 / dt), -guess.strain / dt, jnp.zeros_like(guess.strain))
        equations = Equations(method, layout, moving, history, guess.strain)
        U = equations.start(guess)
        linear = method.linearise(U, *equations._problem)
        units = equations.scale(U)[: layout.size]
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
    """The motion over 0.4 s under gravity that acts from t = 0."""
    return sr.simulate(across(), dt, steps=round(0.4 / dt), **options)


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
                errors = [
                    farthest(
                        gravity_step(dt, scheme=sr.BDFAlpha(alpha)).tip_positions,
                        fine[:: round(dt / FINEST)],
                    )
                    for dt in (10e-3, 5e-3, 2.5e-3)
                ]
            fall = f"{errors[-2] / errors[-1]:.1f}"
            rows.append([f"`BDFAlpha({alpha:g})`", name, *map(short, errors), fall])
    header = ["scheme", "restart", "dt = 10 ms", "5 ms", "2.5 ms", "last two, ratio"]
    return table(header, rows)


FINEST = 1.25e-3


def time_estimates(fine) -> str:
    """The estimated error in time beside the true one, of motions of 0.4 s."""
    rows = []
    for scheme, name in ((sr.SDIRK(4), "SDIRK(4)"), (sr.BDFAlpha(-0.45), "BDFAlpha(-0.45)")):
        for dt in (20e-3, 10e-3, 5e-3, 2.5e-3):
            motion = gravity_step(dt, scheme=scheme)
            true = farthest(motion.tip_positions, fine[:: round(dt / FINEST)])
            estimate = L * motion.stats["time_error"][-1]
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
        ("and from one solve to the next", {}, marching._LEND),
    )
    rows = []
    for dt in (10e-3, 2.5e-3):
        for name, constants, lend in variants:
            patches = [mock.patch.object(newton, k, v) for k, v in constants.items()]
            with patched(*patches, mock.patch.object(marching, "_LEND", lend)), counted() as count:
                motion = gravity_step(dt)
                steps = len(motion.ts) - 1
                evaluations = float(np.mean(motion.stats["iterations"]))
                row = [f"{1e3 * dt:g}", name, f"{evaluations:.1f}", f"{count[0] / steps:.1f}"]
                rows.append(row)
    return table(["dt [ms]", "factors serve", "evaluations a step", "Jacobians a step"], rows)


def stopping(fine) -> str:
    """What a looser tolerance of Newton's method saves, and what it costs."""
    rows, dt = [], 10e-3
    exact = gravity_step(dt, newton=sr.NewtonOptions(1e-12)).tip_positions
    for tolerance in (1e-10, 1e-8, 1e-6, 1e-4):
        motion = gravity_step(dt, newton=sr.NewtonOptions(tolerance))
        evaluations = float(np.mean(motion.stats["iterations"]))
        moved = farthest(motion.tip_positions, exact)
        error = farthest(motion.tip_positions, fine[:: round(dt / FINEST)])
        rows.append([short(tolerance), f"{evaluations:.1f}", short(moved), short(error)])
    header = ["tolerance", "evaluations a step", "off by it [m]", "error of the motion [m]"]
    return table(header, rows)


# --- hard loads ----------------------------------------------------------------------------------


def continuation() -> str:
    """How many of 200 loads, and of 40 jumps, are solved with and without the ways around."""
    rng = np.random.default_rng(0)
    pulls = jnp.array(rng.uniform(0.0, 1.5, (200, 1)) * rng.dirichlet(np.ones(3) * 0.5, 200))
    cases = [
        ("equilibrium, gravity across", across(), pulls),
        ("equilibrium, upright", sr.hybrid_robot(gravity=jnp.array([0.0, 0.0, -9.81])), pulls),
        ("equilibrium, no gravity", sr.hybrid_robot(), pulls),
    ]

    def straight(equations, options, U, before=None):
        return search_directly(equations, options, U)[:2] + (None,)

    def plainly(equations, options, U, before):
        return search_directly(equations, options, U, before.borrowed)

    def solved_static(scene, pulls):
        solve = lambda pull: sr.solve_static(scene, pull, throw=False).result
        return int(np.sum(np.asarray(jax.jit(jax.vmap(solve))(pulls)) == 0))

    rows = []
    for name, scene, pulls_ in cases:
        with patched(mock.patch.object(statics, "search_by_load", straight)):
            bare = solved_static(scene, pulls_)
        with patched():
            row = [name, f"{len(pulls_)}", f"{bare}", f"{solved_static(scene, pulls_)}"]
        rows.append(row)
    for dt in (15e-3, 1e-3):
        with patched(mock.patch.object(marching, "search_by_inertia", plainly)):
            bare = int(np.sum(jumps(dt)[0] == 0))
        with patched():
            real = int(np.sum(jumps(dt)[0] == 0))
        rows.append(
            [f"a tension jumps, dt = {1e3 * dt:g} ms", f"{len(JUMPS)}", f"{bare}", f"{real}"]
        )
    return table(["loads", "how many", "Newton's method alone", "with continuation"], rows)


JUMPS = np.linspace(0.05, 2.0, 40)


def jumps(dt):
    """Results and tips of motions of 10 ms or 10 steps in which one tension jumps."""
    steps = max(10, round(10e-3 / dt))

    def one(pull):
        tensions = jnp.zeros((steps, 3)).at[:, 0].set(pull)
        motion = sr.simulate(sr.hybrid_robot(), dt, tensions, throw=False)
        return motion.result, motion.tip_positions

    return [np.asarray(x) for x in jax.jit(jax.vmap(one))(jnp.array(JUMPS))]


def fronts() -> str:
    """Jumps of a tension with and without artificial viscosity."""
    rows = []
    for dt in (15e-3, 5e-3, 1e-3, 2e-4):
        with patched(mock.patch.object(rod, "_FRONT_VISCOSITY", 1e-12)):
            codes, tips = jumps(dt)
        with patched():
            real_codes, real_tips = jumps(dt)
        both = (codes == 0) & (real_codes == 0) & (JUMPS <= 0.3)
        apart = short(farthest(tips[both], real_tips[both])) if np.any(both) else "–"
        rows.append([f"{1e3 * dt:g}", f"{np.sum(codes == 0)}", f"{np.sum(real_codes == 0)}", apart])
    header = ["dt [ms]", "solved without", "solved with", "tips apart, up to 0.3 N [m]"]
    return table(header, rows)


# --- errors along the rod, derivatives -----------------------------------------------------------


def grid_estimates() -> str:
    """The estimated error along the rod beside the true one, in statics."""
    pull, rows = (0.3, 0.0, 0.0), []
    fine = sr.solve_static(across(), pull, method=sr.Collocation(48)).tip_position
    for order, intervals in ((4, (4, 8, 16)), (6, (4, 6, 8, 12))):
        for count in intervals:
            method = sr.Collocation(count, order=order)
            solution = sr.solve_static(across(), pull, method=method, throw=False)
            true = farthest(solution.tip_position, fine)
            estimate = L * solution.stats["error"]
            row = [f"`Collocation({count}, order={order})`", short(estimate), short(true)]
            rows.append([*row, f"{estimate / true:.1f}"])
    return table(["grid", "estimate [m]", "error [m]", "ratio"], rows)


def derivatives() -> str:
    """Of the tip's x after 20 steps, by three numbers of the scene: three ways."""
    names = ("young_modulus", "bending_damping", "drag_coefficient")
    start = as_arrays(across())
    x0 = jnp.array([float(getattr(start, name)) for name in names])
    tensions = jnp.zeros((20, 3)).at[:, 0].set(0.1)

    def tip(logs):
        values = dict(zip(names, x0 * jnp.exp(logs), strict=True))
        scene = jax.tree.map(lambda x: x, start)
        for name, value in values.items():
            scene = eqx.tree_at(lambda s, n=name: getattr(s, n), scene, value)
        return sr.simulate(scene, 5e-3, tensions).tip_positions[-1, 0]

    zero = jnp.zeros(3)
    forward, reverse = jax.jit(jax.jacfwd(tip))(zero), jax.jit(jax.grad(tip))(zero)
    h, program = 1e-4, jax.jit(tip)
    differences = [(program(h * e) - program(-h * e)) / (2 * h) for e in jnp.eye(3)]
    rows = [
        [
            f"`{name}`",
            f"{forward[i]:.9e}",
            short(abs(reverse[i] / forward[i] - 1)),
            short(abs(differences[i] / forward[i] - 1)),
        ]
        for i, name in enumerate(names)
    ]
    header = ["by the logarithm of", "forward [m]", "reverse: off by", "differences: off by"]
    return table(header, rows)


def main():
    fine = gravity_step(FINEST, scheme=sr.SDIRK(4)).tip_positions
    publish("sweeps", sweeps(), PAGE)
    publish("restarts", restarts(fine), PAGE)
    publish("time estimates", time_estimates(fine), PAGE)
    publish("reuse", reuse(), PAGE)
    publish("stopping", stopping(fine), PAGE)
    publish("continuation", continuation(), PAGE)
    publish("fronts", fronts(), PAGE)
    publish("grid estimates", grid_estimates(), PAGE)
    publish("derivatives", derivatives(), PAGE)
    print(machine())


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    main()
