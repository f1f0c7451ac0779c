"""soromox: segments of piecewise constant strain, integrated by diffrax.

    echo | python benchmarks/peers/soromox_rod.py --segments 4 --dt 1e-4

Gravity is along its y axis, which is x here.
"""

import argparse
from importlib.metadata import version

import common
import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from common import AREA, BENDING_DAMPING, DENSITY, GRAVITY, INERTIA, LENGTH, RADIUS, SHEAR, YOUNG
from soromox.systems import PCS, SystemState
from soromox.systems.components import LinkSpec


def robot(segments: int):
    h = LENGTH / segments
    EI, EA, GA = YOUNG * INERTIA, YOUNG * AREA, SHEAR * AREA
    link = LinkSpec.circular(
        length=h,
        density=DENSITY,
        radius=RADIUS,
        stiffness=h * jnp.diag(jnp.array([2 * SHEAR * INERTIA, EI, EI, EA, GA, GA])),
        damping=h * jnp.diag(BENDING_DAMPING * jnp.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])),
        reference_strain=[0, 0, 0, 1.0, 0, 0],
    )
    return PCS.from_links([link] * segments, gravity=jnp.array([0.0, -GRAVITY, 0.0]))


def prepare(segments: int, dt: float):
    jax.config.update("jax_enable_x64", True)
    rod = robot(segments)
    size = int(rod.num_internal_dofs)
    tip_of = lambda strains: rod.forward_kinematics(strains, jnp.array(LENGTH))[:3, 3]

    @jax.jit
    def path(y0):
        states = rod.rollout_to(
            initial_state=SystemState(t=0.0, y=y0),
            t1=common.DURATION,
            solver_dt=common.SAMPLE / common.steps_per_sample(dt),
            save_dt=common.SAMPLE,
            solver=diffrax.Tsit5(),
            max_steps=None,
        )
        return jax.vmap(tip_of)(states.y[:, :size])

    y0 = jnp.zeros(2 * size)
    program = path.lower(y0).compile()
    return lambda: np.asarray(program(y0))[:, [1, 0, 2]]


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--segments", type=int, required=True)
    parser.add_argument("--dt", type=float, required=True)
    options = parser.parse_args()
    named = f"soromox {version('soromox')}"
    common.serve(named, lambda: prepare(options.segments, options.dt))
