"""What loads and masses do at single places: at the tip, and at gaps between parts of the rod."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from softrod_jax.rod.constants import PointLoad, Rod
from softrod_jax.rod.rotations import cross, to_body
from softrod_jax.rod.state import History, Layout


class Wrench(NamedTuple):
    """(N, M) as a function of (h, q, omega) at a node: its value, (6,), and its derivative.

    At the tip, slips of tendons come before them, which are zero there.
    """

    value: Float[Array, "*gaps tip"]
    by_base_part: Float[Array, "*gaps tip base"]


def tip_condition(y: Float[Array, "n"], rod: Rod, layout: Layout, history) -> Wrench:
    """(N, M) at s = L, which the tip's surroundings ask for (paper eq. 13, total wrench).

    Zero for a free tip, whatever the actuators do. `history` is the one at s = L.
    """
    load = PointLoad(jnp.ones(1), rod.F_tip, rod.M_tip, rod.payload)
    if all(x is None for x in (rod.F_tip, rod.M_tip, rod.payload)):
        return Wrench(jnp.zeros(layout.tip_size), jnp.zeros((layout.tip_size, layout.base_size)))
    base_part = y[: layout.base_size]
    no_slip = jnp.zeros(layout.rubbing)

    def wrench(part):
        applied = _applied(load, part, rod, layout, history)
        return jnp.concatenate([no_slip, applied]) if layout.rubbing else applied

    return Wrench(wrench(base_part), jax.jacfwd(wrench)(base_part))


def gap_conditions(y: Float[Array, "gaps n"], rod: Rod, layout: Layout, history) -> Wrench:
    """N(s-) - N(s+) and M(s-) - M(s+) at every gap, (gaps, 6), and the derivatives.

    `y`: at the nodes before the gaps, as `history` is.
    """
    loads = rod.at_gaps or ()

    def wrench(base_part, history, here):
        applied = [_applied(x, base_part, rod, layout, history) for x in loads]
        return sum((k * w for k, w in zip(here, applied)), jnp.zeros(layout.pair))

    base_part = y[:, : layout.base_size]
    here = jnp.stack([x.here for x in loads], 1)
    axes = History(None, 0, 0)  # pyright: ignore[reportArgumentType]  # in the place of arrays
    along = (0, None if history is None else axes, 0)
    value = jax.vmap(wrench, along)(base_part, history, here)
    return Wrench(value, jax.vmap(jax.jacfwd(wrench), along)(base_part, history, here))


def _applied(load: PointLoad, base_part, rod: Rod, layout: Layout, history):
    """The wrench of a load in the body frame, (6,)."""
    y = jnp.concatenate([base_part, jnp.zeros(layout.pair)])
    h, q, w, _, _ = layout.split(y)
    N, M = jnp.zeros(layout.vector), jnp.zeros(layout.turn)
    if load.F is not None:
        N = N + (to_body(h, load.F) if load.frame == "base" else load.F)
    if load.M is not None:
        # In a plane a turn is the same in both frames.
        fixed = layout.planar or load.frame == "body"
        M = M + (load.M if fixed else to_body(h, load.M))
    if load.mass is not None:
        if rod.gravity is not None:
            N = N + load.mass * to_body(h, rod.gravity)
        if layout.dynamic:
            q_t = history.c0 * q + history.velocity[: layout.vector]
            N = N - load.mass * (q_t + cross(w, q))
    return jnp.concatenate([N, M])
