"""Thousands of samples at once, on all devices there are.

A batch is divided between the devices. On a GPU, each takes its samples in lockstep; on a CPU,
one after the other: there the numbers of one rod stay in the cache, and no sample waits for a
slower one.
"""

from typing import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, PartitionSpec

_SAMPLES = "samples"


def spread(function: Callable, devices=None) -> Callable:
    """`function` of one sample, mapped over the leading axis of all its arguments.

    As `jax.vmap(function)`, whose values and derivatives it has, but on all `devices` (default:
    `jax.devices()`). Any number of samples will do.
    JAX has one device for all cores of a CPU, unless it is told before its first use:

        jax.config.update("jax_num_cpu_devices", os.cpu_count())

    Raises `ValueError` if the arguments' leading axes differ.
    """
    devices = np.array(jax.devices() if devices is None else devices)
    mesh = Mesh(devices, (_SAMPLES,))
    at = PartitionSpec(_SAMPLES)
    in_turn = devices[0].platform == "cpu"

    def on_one_device(arguments):
        if in_turn:
            return jax.lax.map(lambda sample: function(*sample), arguments)
        return jax.vmap(function)(*arguments)

    on_all = jax.jit(
        jax.shard_map(on_one_device, mesh=mesh, in_specs=at, out_specs=at, check_vma=False)
    )

    def mapped(*arguments):
        sizes = {x.shape[0] if jnp.ndim(x) else None for x in jax.tree.leaves(arguments)}
        if len(sizes) != 1 or None in sizes:
            raise ValueError(
                f"spread: leading axes of {sizes}; every argument needs one row a sample"
            )
        count = sizes.pop()
        missing = -count % devices.size
        pad = lambda x: jnp.concatenate([x, jnp.repeat(x[-1:], missing, axis=0)])
        if missing:
            arguments = jax.tree.map(pad, arguments)
        out = on_all(arguments)
        return jax.tree.map(lambda x: x[:count], out) if missing else out

    return mapped
