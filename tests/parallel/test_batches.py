"""Batches over one device and over several, and samples that fail among others."""

import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softrod_jax as sr

SCENE = sr.hybrid_robot(gravity=jnp.array([-9.81, 0.0, 0.0]))
PULLS = 0.1 * jnp.arange(5.0)


def bend(pull):
    """Tip and code of an equilibrium."""
    tensions = pull * jnp.array([1.0, 0.0, 0.0])
    solution = sr.solve_static(SCENE, tensions, throw=False)
    return solution.tip_position, solution.result


@pytest.mark.long
def test_spread_is_vmap_is_a_loop():
    tips, codes = sr.spread(bend)(PULLS)
    np.testing.assert_allclose(tips, jax.vmap(bend)(PULLS)[0], atol=1e-14)
    np.testing.assert_allclose(tips, jnp.stack([bend(x)[0] for x in PULLS]), atol=1e-14)
    assert codes.tolist() == [0] * len(PULLS)
    slope = jax.grad(lambda x: jnp.sum(sr.spread(bend)(x)[0] ** 2))(PULLS)
    expected = jax.vmap(jax.grad(lambda x: jnp.sum(bend(x)[0] ** 2)))(PULLS)
    np.testing.assert_allclose(slope, expected, rtol=1e-9)


def test_one_that_fails_stays_alone():
    pulls = jnp.array([0.1, jnp.nan, 50.0, 0.3])
    tips, codes = sr.spread(bend)(pulls)
    assert codes[0] == codes[3] == 0 and codes[1] != 0 and codes[2] != 0
    np.testing.assert_allclose(tips[::3], sr.spread(bend)(pulls[::3])[0], atol=1e-14)


@pytest.mark.parametrize("arguments", [(PULLS, PULLS[:2]), (0.1,)])
def test_leading_axes_must_agree(arguments):
    with pytest.raises(ValueError, match="one row a sample"):
        sr.spread(lambda *x: x[0])(*arguments)


ON_TWO = """
import jax
jax.config.update("jax_enable_x64", True)
jax.config.update("jax_num_cpu_devices", 2)
import numpy as np
from test_batches import PULLS, bend
import softrod_jax as sr
assert jax.device_count() == 2
on_two = sr.spread(bend)(PULLS)
on_one = sr.spread(bend, devices=jax.devices()[:1])(PULLS)
np.testing.assert_allclose(on_two[0], on_one[0], atol=1e-14)
print("same")
"""


@pytest.mark.long
def test_two_devices_give_the_same():
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join([os.path.dirname(__file__), *sys.path]),
        "JAX_COMPILATION_CACHE_DIR": jax.config.jax_compilation_cache_dir,
    }
    done = subprocess.run(
        [sys.executable, "-c", ON_TWO], env=environment, capture_output=True, text=True
    )
    assert done.stdout == "same\n", done.stderr
