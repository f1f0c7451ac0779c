"""PyElastica: discrete Cosserat elements, explicit in time.

    echo | python benchmarks/peers/pyelastica_rod.py --elements 20

Kelvin-Voigt damping of bending, which the package does not offer, is added as a forcing. The
time step is close to the largest that explicit steps with this damping allow.
"""

import argparse
from importlib.metadata import version

import common
import elastica
import numpy as np
from common import AREA, BENDING_DAMPING, DENSITY, GRAVITY, INERTIA, LENGTH, RADIUS, SHEAR, YOUNG
from elastica.external_forces import NoForces
from numba import njit


class Simulator(elastica.BaseSystemCollection, elastica.Constraints, elastica.Forcing):
    """What the rod is put together from."""


@njit(cache=True)
def add_damping(omega, h, torques):
    # Directors of neighbouring elements are nearly aligned: their frames are taken for one.
    for k in range(omega.shape[1] - 1):
        for i in range(3):
            moment = BENDING_DAMPING * (omega[i, k + 1] - omega[i, k]) / h
            torques[i, k] += moment
            torques[i, k + 1] -= moment


class BendingDamping(NoForces):
    def apply_torques(self, system, time=0.0):
        add_damping(system.omega_collection, system.rest_lengths[0], system.external_torques)


def build(elements: int):
    simulator = Simulator()
    along, normal = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])
    rod = elastica.CosseratRod.straight_rod(
        elements,
        np.zeros(3),
        along,
        normal,
        LENGTH,
        RADIUS,
        DENSITY,
        youngs_modulus=YOUNG,
        shear_modulus=SHEAR,
    )
    # No shear correction, as in the paper.
    rod.shear_matrix[0, 0, :] = rod.shear_matrix[1, 1, :] = SHEAR * AREA
    simulator.append(rod)
    clamp = dict(constrained_position_idx=(0,), constrained_director_idx=(0,))
    simulator.constrain(rod).using(elastica.OneEndFixedBC, **clamp)
    gravity = np.array([-GRAVITY, 0.0, 0.0])
    simulator.add_forcing_to(rod).using(elastica.GravityForces, acc_gravity=gravity)
    simulator.add_forcing_to(rod).using(BendingDamping)
    simulator.finalize()
    return simulator, rod


def prepare(elements: int):
    diffusivity = BENDING_DAMPING / (DENSITY * INERTIA)
    steps = common.steps_per_sample(0.45 * (LENGTH / elements) ** 2 / (2 * diffusivity))
    dt = np.float64(common.SAMPLE / steps)
    stepper = elastica.PositionVerlet()

    def simulate(samples=common.SAMPLES, steps=steps):
        simulator, rod = build(elements)
        t, path = np.float64(0.0), [rod.position_collection[:, -1].copy()]
        for _ in range(samples):
            for _ in range(steps):
                t = stepper.step(simulator, t, dt)
            tip = rod.position_collection[:, -1].copy()
            if not np.linalg.norm(tip) < 2 * LENGTH:
                return None
            path.append(tip)
        return path

    simulate(1, 5)  # compiles
    return simulate


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--elements", type=int, required=True)
    options = parser.parse_args()
    common.serve(f"PyElastica {version('pyelastica')}", lambda: prepare(options.elements))
