"""The rod in a learning pipeline: one step at a time, as a layer, as an environment.

`learning`, and is imported by itself: `from softrod_jax.learning.environment import ReachEnv`.
"""

from softrod_jax.learning.layer import RodLayer as RodLayer
from softrod_jax.learning.layer import RodPath as RodPath
from softrod_jax.learning.stepping import Action as Action
from softrod_jax.learning.stepping import RodState as RodState
from softrod_jax.learning.stepping import RodView as RodView
from softrod_jax.learning.stepping import Stepper as Stepper
from softrod_jax.learning.stepping import reset_where as reset_where
