"""Thousands of samples at once, on all devices there are, of one host or of several.

A batch is divided between the devices. On a GPU, each takes its samples in lockstep; on a CPU,
one after the other: there the numbers of one rod stay in the cache, and no sample waits for a
slower one. Devices do not wait for each other either, until results are gathered.
"""

import functools
import hashlib
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from softrod_jax.foundation.compiling import compiled
from softrod_jax.foundation.tracing import is_traced

_SAMPLES = "samples"


def spread(function: Callable, devices=None, *, gather: bool = True) -> Callable:
    """`function` of one sample, mapped over the leading axis of all its arguments.

    As `jax.vmap(function)`, whose values and derivatives it has, but on all `devices` (default:
    `jax.devices()`, those of all processes). Any number of samples will do.
    JAX has one device for all cores of a CPU, unless it is told before its first use:

        jax.config.update("jax_num_cpu_devices", os.cpu_count())

    On several hosts, or in several processes, each runs the same program, which begins with
    `jax.distributed.initialize`, and calls with the whole batch, the same in all of them. What
    comes back depends on

    - `gather`: if true, each process has the whole result, in arrays of its own. If false, the
      results stay where they were computed, as arrays that are divided over the leading axis:
      `x.addressable_shards` are the rows of this process, and
      `jax.experimental.multihost_utils.process_allgather(x, tiled=True)` gathers them later. The
      number of samples must then be a multiple of the number of devices.

    An argument may itself be such a divided array, of which no process has the whole batch: see
    `jax.make_array_from_process_local_data`. In one process `gather` changes nothing. If a process
    is lost, JAX ends the others with an error within minutes; see `sweep` for what is kept.

    Raises `ValueError` if the arguments' leading axes differ, if processes call with different
    batches, or if no device is of this process.
    """
    devices = np.array(jax.devices() if devices is None else devices)
    processes = {device.process_index for device in devices.flat}
    several = len(processes) > 1
    if jax.process_index() not in processes:
        raise ValueError(
            f"spread: none of {devices.size} devices is of this process, number "
            f"{jax.process_index()}; give jax.devices(), or some of jax.local_devices()"
        )
    mesh = Mesh(devices, (_SAMPLES,))
    rows = NamedSharding(mesh, PartitionSpec(_SAMPLES))
    everywhere = NamedSharding(mesh, PartitionSpec())
    gathered = several and gather
    in_turn = devices[0].platform == "cpu"

    def on_one_device(arguments):
        if in_turn:
            return jax.lax.map(lambda sample: function(*sample), arguments)
        return jax.vmap(function)(*arguments)

    on_all = compiled(
        jax.shard_map(
            on_one_device, mesh=mesh, in_specs=rows.spec, out_specs=rows.spec, check_vma=False
        ),
        functools.partial(jax.jit, out_shardings=everywhere if gathered else rows),
    )

    def mapped(*arguments):
        count = count_samples("spread", arguments)
        missing = -count % devices.size
        if missing and several and not gather:
            raise ValueError(
                f"spread: {count} samples on {devices.size} devices; without gather, a multiple "
                "of the number of devices is needed"
            )
        traced = is_traced(arguments)
        if several and not traced:
            _check_same(arguments, rows, everywhere)
        if missing:
            arguments = jax.tree.map(lambda x: padded(x, count + missing), arguments)
        if not traced:
            arguments = jax.tree.map(lambda x: _placed(x, rows), arguments)
        elif gathered:
            # So that derivatives by the arguments are gathered, too.
            arguments = jax.lax.with_sharding_constraint(arguments, everywhere)
        out = on_all(arguments)
        if gathered and not traced:
            out = jax.tree.map(lambda x: x.addressable_data(0), out)
        return jax.tree.map(lambda x: x[:count], out) if missing else out

    return mapped


def padded(x, count: int):
    """`x` with its last row repeated until it has `count` rows."""
    return jnp.concatenate([x, jnp.repeat(x[-1:], count - x.shape[0], axis=0)])


def digest(tree) -> bytes:
    """Sixteen bytes that tell apart pytrees with other structures, shapes or numbers."""
    leaves, structure = jax.tree.flatten(tree)
    parts = hashlib.blake2b(str(structure).encode(), digest_size=16)
    for x in leaves:
        if jnp.issubdtype(x.dtype, jax.dtypes.prng_key):
            x = jax.random.key_data(x)
        parts.update(f"{x.dtype}{x.shape}".encode())
        parts.update(np.ascontiguousarray(x).tobytes())
    return parts.digest()


def count_samples(who: str, arguments) -> int:
    """How many rows each array in `arguments` has; an error if they differ."""
    sizes: set[Any] = {x.shape[0] if jnp.ndim(x) else None for x in jax.tree.leaves(arguments)}
    if len(sizes) != 1 or None in sizes:
        raise ValueError(f"{who}: leading axes of {sizes}; every argument needs one row a sample")
    return sizes.pop()


def _check_same(arguments, rows: NamedSharding, everywhere: NamedSharding) -> None:
    """Without this, processes with different random numbers would mix their batches."""
    own = digest([x for x in jax.tree.leaves(arguments) if not _divided(x)])
    own = np.frombuffer(own, dtype=np.uint8)[None]
    shape = (rows.mesh.size, own.shape[1])
    every = jax.make_array_from_callback(shape, rows, lambda index: own)
    every = np.asarray(jax.jit(lambda x: x, out_shardings=everywhere)(every))
    if np.any(every != every[0]):
        raise ValueError(
            "spread: the processes call with different batches; give each the whole batch, the "
            "same in all of them: random samples need the same seed"
        )


def _divided(x) -> bool:
    """Whether other processes have parts of it."""
    return isinstance(x, jax.Array) and not x.is_fully_addressable


def _placed(x, rows: NamedSharding):
    """`x` divided over the devices."""
    if rows.is_fully_addressable:
        return jax.device_put(x, rows)
    if _divided(x) or jnp.issubdtype(x.dtype, jax.dtypes.extended):
        return x
    host = np.asarray(x)
    return jax.make_array_from_callback(host.shape, rows, lambda index: host[index])
