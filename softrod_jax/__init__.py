"""softrod_jax: a differentiable dynamic Cosserat rod of soft robots."""

from softrod_jax.batches import spread as spread
from softrod_jax.collocation import Collocation as Collocation
from softrod_jax.dynamics import Trajectory as Trajectory
from softrod_jax.dynamics import simulate as simulate
from softrod_jax.newton import NewtonOptions as NewtonOptions
from softrod_jax.results import RESULTS as RESULTS
from softrod_jax.results import SolveError as SolveError
from softrod_jax.results import result_message as result_message
from softrod_jax.scene import Chambers as Chambers
from softrod_jax.scene import Payload as Payload
from softrod_jax.scene import Scene as Scene
from softrod_jax.scene import Tendons as Tendons
from softrod_jax.scene import TipLoad as TipLoad
from softrod_jax.scene import hybrid_robot as hybrid_robot
from softrod_jax.scene_file import SceneError as SceneError
from softrod_jax.scene_file import load_scene as load_scene
from softrod_jax.scene_file import save_scene as save_scene
from softrod_jax.sections import Annulus as Annulus
from softrod_jax.sections import Circle as Circle
from softrod_jax.sections import GeneralSection as GeneralSection
from softrod_jax.sections import Rectangle as Rectangle
from softrod_jax.shooting import Shooting as Shooting
from softrod_jax.statics import StaticSolution as StaticSolution
from softrod_jax.statics import solve_static as solve_static
from softrod_jax.time_schemes import SDIRK as SDIRK
from softrod_jax.time_schemes import BDFAlpha as BDFAlpha
