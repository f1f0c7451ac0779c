"""Young's modulus, of a linear law or of a rubber."""

from dataclasses import dataclass

import equinox as eqx
import jax

import softrod_jax as sr
from calibration.experiment.setup import Setup
from calibration.parameters.parameter import AbstractParameter
from softrod_jax.scene.materials import AbstractRubber


def is_rubber(scene: sr.Scene) -> bool:
    """Whether the whole rod has a law of rubber."""
    return isinstance(scene.material, AbstractRubber)


@dataclass(frozen=True)
class Modulus(AbstractParameter):
    """Young's modulus; of a rubber that at small strain, by which all its constants change in
    proportion: what nearly every motion tells of them, while their proportion shows at large
    strain only."""

    def get(self, setup: Setup):
        material = setup.scene.material
        if isinstance(material, AbstractRubber):
            return material.young_modulus
        return setup.scene.young_modulus

    def put(self, setup: Setup, value) -> Setup:
        scene = setup.scene
        if not isinstance(scene.material, AbstractRubber):
            return eqx.tree_at(lambda s: s.scene.young_modulus, setup, value)
        factor = value / scene.material.young_modulus
        law = jax.tree.map(lambda x: factor * x, scene.material)
        return eqx.tree_at(lambda s: s.scene.material, setup, law)
