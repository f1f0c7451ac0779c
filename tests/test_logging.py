"""What the packages say of themselves through `logging`: nothing unless asked, and not in jit."""

import logging
import subprocess
import sys

import jax
import jax.numpy as jnp
import pytest

import softrod_jax as sr

PULL = (0.1, 0.0, 0.0)


@pytest.mark.parametrize("package", ["softrod_jax", "calibration"])
def test_a_package_is_silent_until_it_is_asked(package):
    code = f"import {package}, logging\nlogger = logging.getLogger({package!r})\n"
    code += "print([type(h).__name__ for h in logger.handlers], logger.level)\n"
    code += "logging.getLogger(logger.name + '.any').error('not to be seen')"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("['NullHandler'] 0\n", "")


def test_a_grid_that_is_refined_is_told(caplog):
    caplog.set_level(logging.DEBUG, "softrod_jax")
    scene = sr.hybrid_robot(gravity=[2.0, 0.0, 0.0])
    solution = sr.solve_static(scene, PULL, method=sr.Collocation(2), tolerance=1e-5)
    said = [r.getMessage() for r in caplog.records if r.name == "softrod_jax.bvp.grid_control"]
    assert said and said[0].startswith("2 intervals along the rod: ")
    assert said[-1].endswith(f"; next {solution.method.intervals}")
    (end,) = [r.getMessage() for r in caplog.records if r.name == "softrod_jax.statics"]
    count = int(solution.stats["iterations"])
    assert end.startswith(f"equilibrium: successful, {count} iterations, ")


def test_motions_that_are_repeated_are_told(caplog):
    caplog.set_level(logging.INFO, "softrod_jax")
    pull = jnp.linspace(0.0, 1.0, 2)[:, None] * jnp.array(PULL)
    motion = sr.simulate(sr.hybrid_robot(), 0.02, pull, method=sr.Collocation(4), tolerance=1e-2)
    said = [r.getMessage() for r in caplog.records]
    assert len(said) > 1 and said[0].startswith("the motion at first: successful, ")
    count = int(motion.stats["substeps"].sum())
    assert said[-1].endswith(f"{count} substeps, {int(motion.stats['intervals'])} intervals")


def test_nothing_is_said_from_compiled_programs(caplog):
    caplog.set_level(logging.DEBUG, "softrod_jax")
    scene, method = sr.hybrid_robot(), sr.Collocation(2)
    tip = lambda pull: sr.solve_static(scene, pull, method=method, throw=False).tip_position
    jax.block_until_ready(jax.jit(jax.vmap(tip))(jnp.array([PULL, PULL])))
    jax.block_until_ready(jax.jacfwd(tip)(jnp.array(PULL)))
    assert caplog.records == []
