"""Two processes with two devices each compute what one process with one device does."""

import jax
import numpy as np
import processes
import pytest
import together

import softrod_jax as sr

CONNECTED = """
import sys
import jax
jax.config.update("jax_enable_x64", True)
jax.config.update("jax_num_cpu_devices", 2)
address, number, directory = sys.argv[1], int(sys.argv[2]), sys.argv[3]
jax.distributed.initialize(address, 2, number, initialization_timeout=60)
import jax.numpy as jnp
import numpy as np
import pytest
import softrod_jax as sr
from jax.experimental.multihost_utils import process_allgather
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from together import PULLS, bend, fit, wave
assert jax.device_count() == 4 and jax.local_device_count() == 2
"""

SPREAD = """
x = np.random.default_rng(0).normal(size=(7, 3))
on_one = sr.spread(wave, jax.local_devices()[:1])

def same(a, b):
    for one, other in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True):
        np.testing.assert_array_equal(np.asarray(one), np.asarray(other))

# The whole batch in, the whole result out, in arrays of this process alone.
out = sr.spread(wave)(x)
assert all(y.is_fully_addressable for y in out)
same(out, on_one(x))
same(sr.spread(wave)(*[jnp.asarray(x)]), out)
same(sr.spread(lambda a, b: a + b)(out[1], out[1]), 2 * out[1])

# Derivatives, eager and compiled.
loss = lambda mapped: lambda x: jnp.sum(mapped(x)[0] ** 2)
slope = jax.grad(loss(on_one))(x)
same(jax.grad(loss(sr.spread(wave)))(x), slope)
same(jax.jit(jax.grad(loss(sr.spread(wave))))(x), slope)

# Left where they are: two rows a device, four a process.
eight = np.concatenate([x, x[:1]])
divided = sr.spread(wave, gather=False)
out = divided(eight)
whole = on_one(eight)
assert not out[0].is_fully_addressable
for shard in out[0].addressable_shards:
    assert shard.data.shape == (2, 3)
    same(shard.data, whole[0][shard.index])
same(process_allgather(out, tiled=True), whole)
with pytest.raises(ValueError, match="7 samples on 4 devices"):
    divided(x)

# Rows of its own from each process.
rows = NamedSharding(Mesh(np.array(jax.devices()), ("any",)), PartitionSpec("any"))
mine = jax.make_array_from_process_local_data(rows, eight[4 * number : 4 * number + 4])
same(sr.spread(wave)(mine), whole)

# Batches that are not the same.
with pytest.raises(ValueError, match="different batches"):
    sr.spread(wave)(x + number)
with pytest.raises(ValueError, match="different batches"):
    sr.spread(wave)(x[: 7 - number])
with pytest.raises(ValueError, match="none of 2 devices is of this process"):
    sr.spread(wave, jax.devices()[2 - 2 * number :][:2])

# A sweep: each process ends with all of it.
swept = sr.sweep(wave, x, directory=directory + "/sweep", chunk=2)
same(swept, on_one(x))

bent = jax.tree.leaves(sr.spread(bend)(PULLS))
np.savez(f"{directory}/bent{number}.npz", *bent)
"""

FIT = """
np.savez(f"{directory}/fit{number}.npz", **fit())
"""


def equal_in_both(directory, name, expected):
    for number in range(2):
        with np.load(directory / f"{name}{number}.npz") as found:
            for key, one in expected.items():
                np.testing.assert_allclose(found[key], one, rtol=1e-12, atol=1e-15, err_msg=key)


@pytest.fixture(scope="module")
def connected(tmp_path_factory):
    """Where two connected processes have left what they computed."""
    directory = tmp_path_factory.mktemp("connected")
    processes.run_together(CONNECTED + SPREAD + FIT, 2, str(directory), timeout=600)
    return directory


@pytest.mark.long
def test_a_batch(connected):
    bent = jax.tree.leaves(sr.spread(together.bend)(together.PULLS))
    equal_in_both(connected, "bent", {f"arr_{k}": np.asarray(x) for k, x in enumerate(bent)})


@pytest.mark.long
def test_a_calibration(connected):
    equal_in_both(connected, "fit", together.fit())


FAILS = """
import sys
import time
if sys.argv[2] == "1":
    sys.exit("gives up")
time.sleep(600)
"""
HANGS = "import time; time.sleep(600)"


@pytest.mark.parametrize(
    "script, words", [(FAILS, "process 1: 1\ngives up"), (HANGS, "no end within 2 s")]
)
def test_no_process_outlives_the_others_or_its_time(script, words):
    with pytest.raises(AssertionError, match=words):
        processes.run_together(script, 2, timeout=2)
