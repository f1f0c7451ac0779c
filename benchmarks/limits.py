"""What bounds a step: the arithmetic of its parts, and what this device can do at most.

    python benchmarks/limits.py [--sizes 1 16 64] [--profile FOLDER] [--write-docs]

Newton's method along the rod has three parts: the equations are evaluated, new factors of their
Jacobian are made, and a correction follows from both. Counted are the operations of the traced
programs (an addition, a multiplication or any other function of a number is one); measured, the
time for one rod and for many in lockstep (`jax.vmap`), per rod. The most that the device
can do is measured, too: products of large matrices, of as many matrices as a rod has intervals, of
the size of those, and copies in memory. With --profile, JAX's profiler keeps a trace of a batch
of motions in FOLDER, for TensorBoard or Perfetto.
"""

import argparse
import math
import time

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import numpy as np
from report import machine, publish, table
from skip import programs_inside

import softrod_jax as sr
from softrod_jax.bvp.equations import Equations
from softrod_jax.bvp.unloaded import unloaded_guess
from softrod_jax.foundation.compiling import compiler_options
from softrod_jax.rod.reduction import make_rod
from softrod_jax.rod.state import History, layout_of
from softrod_jax.scene.inputs import Inputs

DT, REPEATS = 15e-3, 7
METHOD = sr.Collocation()
SCENE = sr.hybrid_robot(gravity=jnp.array([-9.81, 0.0, 0.0]))
# Moving numbers is no operation on them.
MOVES = {
    "broadcast_in_dim",
    "concatenate",
    "convert_element_type",
    "copy",
    "dynamic_slice",
    "dynamic_update_slice",
    "gather",
    "iota",
    "pad",
    "reshape",
    "rev",
    "scatter",
    "select_n",
    "slice",
    "squeeze",
    "stop_gradient",
    "transpose",
}


def operations(jaxpr) -> int:
    """Of a traced program. Loops must have a known number of passes."""
    count = 0
    for equation in jaxpr.eqns:
        inner = programs_inside(equation)
        name, shape = equation.primitive.name, equation.outvars[0].aval.shape
        if name == "while":
            raise ValueError("operations: how often a `while` loop runs is not known")
        if inner:
            passes = equation.params["length"] if name == "scan" else 1
            count += passes * sum(map(operations, inner))
        elif name == "dot_general":
            (summed, _), _ = equation.params["dimension_numbers"]
            left = equation.invars[0].aval.shape
            count += 2 * math.prod(shape) * math.prod(left[k] for k in summed)
        elif name.startswith("reduce"):
            count += math.prod(equation.invars[0].aval.shape)
        elif name not in MOVES and jnp.issubdtype(equation.outvars[0].aval.dtype, jnp.inexact):
            count += math.prod(shape)
    return count


def parts():
    """{part: (function of one rod, its arguments)}."""
    tensions = jnp.array([0.1, 0.2, 0.3])
    rod_under = lambda tensions: make_rod(
        SCENE, Inputs(tensions, jnp.array([1e4])), grid=METHOD.grid(SCENE), spread_fronts=True
    )
    layout = layout_of(rod_under(tensions), dynamic=True)
    guess = unloaded_guess(layout, rod_under(tensions))
    c0 = jnp.array(1.5 / DT)
    history = History(c0, -c0 * guess.strain, jnp.zeros_like(guess.strain))

    def equations(tensions):
        return Equations(METHOD, layout, rod_under(tensions), history, guess.strain)

    evaluate = lambda U, tensions: equations(tensions).residual(U)
    factorise = lambda U, tensions: equations(tensions).factorise(U)
    correct = lambda F, factors, tensions: equations(tensions).correct(factors, F)
    U = equations(tensions).start(guess)
    noise = jax.random.normal(jax.random.key(0), U.along.shape)
    U = U._replace(along=U.along * (1 + 1e-3 * noise))
    F, factors = evaluate(U, tensions), factorise(U, tensions)
    return {
        "evaluation": (evaluate, (U, tensions)),
        "correction": (correct, (F, factors, tensions)),
        "new factors": (factorise, (U, tensions)),
    }


def seconds(function, arguments, passes: int = 50) -> float:
    """The median time of one call, of many in one program that depend on each other."""

    def run(first, *rest):
        def body(_, carry):
            first, _ = carry
            out = function(first, *rest)
            leaves, structure = jax.tree.flatten(first)
            leaves[0] += 1e-14 * jax.tree.leaves(out)[0].ravel()[0]
            return jax.tree.unflatten(structure, leaves), out

        return jax.lax.fori_loop(0, passes, body, (first, function(first, *rest)))

    program = jax.jit(run, compiler_options=compiler_options())
    jax.block_until_ready(program(*arguments))
    taken = []
    for _ in range(REPEATS):
        begin = time.perf_counter()
        jax.block_until_ready(program(*arguments))
        taken.append(time.perf_counter() - begin)
    return float(np.median(taken)) / (passes + 1)


def most() -> dict[str, tuple[float, str]]:
    """What this device can do: {what: (number, unit)}."""
    normal = lambda *shape: jax.random.normal(jax.random.key(1), shape)
    large, small, tall = normal(1024, 1024), normal(12, 16, 16), normal(12, 16, 32)
    product = lambda x, y: x @ y
    copied = normal(2**23)
    return {
        "products of 1024 x 1024": (2 * 1024**3 / seconds(product, (large, large), 3), "op/s"),
        "12 products of 16 x 16 by 16 x 32": (
            2 * small.size * 32 / seconds(product, (small, tall)),
            "op/s",
        ),
        "copying 64 MB": (2 * copied.nbytes / seconds(lambda x: 1.5 * x, (copied,), 3), "B/s"),
    }


def rods(count: int, arguments):
    """The arguments of one rod `count` times; of a batch none is shared."""
    return jax.tree.map(lambda x: jnp.tile(x, (count, *[1] * x.ndim)), arguments)


def profile(folder: str, size: int) -> None:
    """Keep a trace of `size` motions at once."""
    tensions = jnp.tile(jnp.linspace(0.0, 0.3, 20)[:, None], (size, 1, 3))
    run = lambda T: sr.simulate(SCENE, DT, T, throw=False).tip_positions
    program = sr.spread(run)
    jax.block_until_ready(program(tensions))
    with jax.profiler.trace(folder):
        jax.block_until_ready(program(tensions))


def main() -> None:
    on_gpu = jax.default_backend() != "cpu"
    parser = argparse.ArgumentParser()
    default = [1, 256, 4096, 65536] if on_gpu else [1, 16, 64]
    parser.add_argument("--sizes", type=int, nargs="+", default=default)
    parser.add_argument("--profile")
    parser.add_argument("--write-docs", action="store_true")
    options = parser.parse_args()
    rows = []
    for name, (function, arguments) in parts().items():
        count = operations(jax.make_jaxpr(function)(*arguments).jaxpr)
        row = [name, f"{count / 1e3:.0f}"]
        for size in options.sizes:
            if size == 1:
                taken = seconds(function, arguments)
            else:
                taken = seconds(jax.vmap(function), rods(size, arguments)) / size
            row += [f"{1e6 * taken:.{1 if taken < 1e-5 else 0}f}", f"{count / taken / 1e9:.1f}"]
        rows.append(row)
        print(row, flush=True)
    header = ["", "operations [1000]"]
    for size in options.sizes:
        header += [f"{size} rod{'s' * (size > 1)} [us]", "[Gop/s]"]
    can = "; ".join(f"{what}: {x / 1e9:.0f} G{unit}" for what, (x, unit) in most().items())
    _, (_, factors, _) = parts()["correction"]
    kept = f"The factors of a rod: {sum(x.nbytes for x in jax.tree.leaves(factors)) / 1e6:.2f} MB."
    where = f"{machine()}, `{jax.devices()[0].device_kind}`"
    publish("limits", "benchmarks.md", f"{table(header, rows)}\n\n{kept} At most: {can}. {where}.")
    if options.profile:
        profile(options.profile, max(options.sizes))


if __name__ == "__main__":
    main()
