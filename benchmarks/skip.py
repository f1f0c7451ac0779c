"""What each part of a scene costs: a full scene, and the same without one part at a time.

    python benchmarks/skip.py [--write-docs]

A part that is absent from a scene is not in the program. Counted are the equations of the traced
program (jaxpr) and the unknowns at each point along the rod; measured, the time to compile and
that of a step (for statics: of a solve), the median of interleaved repeats. A motion without a
part is another motion, which may need more or fewer evaluations of the rod equations a step:
they are in the table, too. The whole scene is in the plane x-z, so that it may be solved there.
About 4 minutes.
"""

import dataclasses
import functools
import time

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr
from report import machine, publish, table

import softrod_jax as sr
from softrod_jax.bvp.unloaded import unloaded_guess
from softrod_jax.rod.reduction import make_rod
from softrod_jax.rod.state import layout_of
from softrod_jax.scene.inputs import Inputs
from softrod_jax.scene.scene import as_arrays

DT, STEPS, REPEATS = 5e-3, 100, 9
TENSIONS, PRESSURES = (0.1, 0.05, 0.0), (1e4,)
# What is absent from a scene: fields of `Scene` that are then None.
PARTS = {
    "tendons": ("tendons",),
    "chamber": ("chambers",),
    "gravity": ("gravity",),
    "drag": ("drag_coefficient",),
    "damping": ("bending_damping", "shear_damping"),
    "payload": ("payload",),
}


def full_scene():
    scene = sr.hybrid_robot(gravity=np.array([-9.81, 0.0, 0.0]))
    in_the_plane = sr.Tendons(np.array([[4e-3, 0.0], [-2e-3, 0.0], [-4e-3, 0.0]]))
    parts = dict(tendons=in_the_plane, shear_damping=1e-3, payload=sr.Payload(1e-3))
    return as_arrays(dataclasses.replace(scene, **parts))


def without(*parts):
    """The full scene without these `PARTS`."""
    absent = {field: None for part in parts for field in PARTS[part]}
    return dataclasses.replace(full_scene(), **absent)


def restricted(**restrictions):
    """The full scene, but for a damping that an inextensible one cannot have."""
    if restrictions.get("inextensible"):
        restrictions["shear_damping"] = None
    return dataclasses.replace(full_scene(), **restrictions)


def actuation(scene):
    """Tensions and pressures of one step; None for an actuator that the scene lacks."""
    tensions = None if scene.tendons is None else jnp.array(TENSIONS)
    pressures = None if scene.chambers is None else jnp.array(PRESSURES)
    return tensions, pressures


def motion(scene, tensions, pressures, change=0.0, whole=False):
    """A motion's tip, or all of it, its result and evaluations per step.

    Inputs `change` by this part to and fro, twice in the motion.
    """
    wave = 1 - change * np.sin(4 * np.pi * np.arange(1, STEPS + 1) / STEPS)[:, None] ** 2
    rows = lambda x: None if x is None else wave * x
    inputs = rows(tensions), rows(pressures)
    moved = sr.simulate(scene, DT, *inputs, steps=STEPS, max_time_error=jnp.inf, throw=False)
    out = moved if whole else moved.tip_positions
    return out, moved.result, jnp.mean(moved.stats["iterations"])


whole_motion = functools.partial(motion, whole=True)
changing = functools.partial(motion, change=0.5)


def equilibrium(scene, tensions, pressures):
    """An equilibrium's tip, result and evaluations."""
    solution = sr.solve_static(scene, tensions, pressures, throw=False)
    return solution.tip_position, solution.result, solution.stats["iterations"]


def programs():
    """{row: (function, scene)}"""
    stiff, flat = {"inextensible": True}, {"plane": "xz"}
    restrictions = {"inextensible": stiff, "planar": flat, "planar, inextensible": stiff | flat}
    return {
        "everything": (motion, without()),
        "the whole shape, not the tip alone": (whole_motion, without()),
        "inputs that change": (changing, without()),
        **{f"no {part}": (motion, without(part)) for part in PARTS},
        # Without gravity, too, nothing would move.
        "gravity only": (motion, without(*set(PARTS) - {"gravity"})),
        **{name: (motion, restricted(**values)) for name, values in restrictions.items()},
        "everything, static": (equilibrium, without()),
        **{
            f"{name}, static": (equilibrium, restricted(**values))
            for name, values in restrictions.items()
        },
        "tendons only, static": (equilibrium, without(*set(PARTS) - {"tendons"})),
    }


def trace(function, scene):
    """The traced program, and what it is called with."""
    arguments = scene, *actuation(scene)
    return jax.jit(function).trace(*arguments), arguments


def count_equations(jaxpr) -> int:
    """Of a program and of all programs inside it, each once wherever it is written."""
    inside = [x for equation in jaxpr.eqns for x in programs_inside(equation)]
    return len(jaxpr.eqns) + sum(map(count_equations, inside))


def programs_inside(equation) -> list[Jaxpr]:
    """Those that an equation of a traced program calls, or repeats."""
    found = jax.tree.leaves(list(equation.params.values()))
    opened = [x.jaxpr if isinstance(x, ClosedJaxpr) else x for x in found]
    return [x for x in opened if isinstance(x, Jaxpr)]


def count_unknowns(function, scene) -> int:
    """At each point along the rod."""
    dynamic, method = function is not equilibrium, sr.Collocation()
    rod = make_rod(scene, Inputs(*actuation(scene)), dynamic=dynamic, grid=method.grid(scene))
    layout = layout_of(rod, dynamic=dynamic)
    return method.unknowns(unloaded_guess(layout, rod), rod).shape[1]


def main() -> None:
    rows, compiled = {}, {}
    for name, (function, scene) in programs().items():
        begin = time.perf_counter()
        traced, arguments = trace(function, scene)
        program = traced.lower().compile()
        seconds = time.perf_counter() - begin
        _, result, evaluations = jax.block_until_ready(program(*arguments))
        if int(result):
            raise RuntimeError(f"{name}: {sr.result_message(int(result))}")
        compiled[name] = lambda run=program, inputs=arguments: jax.block_until_ready(run(*inputs))
        counts = [count_equations(traced.jaxpr), count_unknowns(function, scene)]
        rows[name] = [*map(str, counts), f"{seconds:.1f}", f"{float(evaluations):.1f}"]
    samples = {name: [] for name in compiled}
    for _ in range(REPEATS):
        for name, run in compiled.items():
            begin = time.perf_counter()
            run()
            samples[name].append(time.perf_counter() - begin)
    for name, times in samples.items():
        count = 1 if programs()[name][0] is equilibrium else STEPS
        rows[name].append(f"{1e3 * np.median(times) / count:.2g}")
    header = ["", "equations traced", "unknowns a point", "compile [s]", "evaluations a step"]
    text = table([*header, "step [ms]"], [[name, *row] for name, row in rows.items()])
    publish("skip", "benchmarks.md", f"{text}\n\n{machine()}.")


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_enable_compilation_cache", False)
    main()
