"""softrod_jax: a differentiable dynamic Cosserat rod of soft robots."""

import logging as _logging

from softrod_jax.analysis.inverse import InverseSolution as InverseSolution
from softrod_jax.analysis.inverse import inverse as inverse
from softrod_jax.analysis.linear import LinearModel as LinearModel
from softrod_jax.analysis.linear import linearise as linearise
from softrod_jax.analysis.modes import Modes as Modes
from softrod_jax.analysis.modes import modes as modes
from softrod_jax.analysis.reduced_rod import ReducedRod as ReducedRod
from softrod_jax.analysis.reduced_rod import reduce_nonlinear as reduce_nonlinear
from softrod_jax.analysis.self_distance import self_distance as self_distance
from softrod_jax.analysis.sensitivities import actuation_jacobian as actuation_jacobian
from softrod_jax.analysis.sensitivities import compliance as compliance
from softrod_jax.bvp.collocation import Collocation as Collocation
from softrod_jax.bvp.newton import NewtonOptions as NewtonOptions
from softrod_jax.bvp.shooting import Shooting as Shooting
from softrod_jax.control.estimation import Estimator as Estimator
from softrod_jax.control.predictive import Predictive as Predictive
from softrod_jax.dynamics import Trajectory as Trajectory
from softrod_jax.dynamics import simulate as simulate
from softrod_jax.foundation.results import RESULTS as RESULTS
from softrod_jax.foundation.results import SolveError as SolveError
from softrod_jax.foundation.results import result_message as result_message
from softrod_jax.parallel.batches import spread as spread
from softrod_jax.parallel.sweeps import SweepError as SweepError
from softrod_jax.parallel.sweeps import sweep as sweep
from softrod_jax.scene.acting import AbstractCondition as AbstractCondition
from softrod_jax.scene.acting import AbstractDissipation as AbstractDissipation
from softrod_jax.scene.acting import AbstractDistributedLoad as AbstractDistributedLoad
from softrod_jax.scene.acting import AbstractEnergy as AbstractEnergy
from softrod_jax.scene.acting import Here as Here
from softrod_jax.scene.chambers import Chambers as Chambers
from softrod_jax.scene.contacts import AbstractObstacle as AbstractObstacle
from softrod_jax.scene.contacts import Contact as Contact
from softrod_jax.scene.contacts import Plane as Plane
from softrod_jax.scene.contacts import Sphere as Sphere
from softrod_jax.scene.contacts import Tube as Tube
from softrod_jax.scene.distance_grid import DistanceGrid as DistanceGrid
from softrod_jax.scene.distance_grid import sample_distance as sample_distance
from softrod_jax.scene.file import SceneError as SceneError
from softrod_jax.scene.file import load_scene as load_scene
from softrod_jax.scene.file import save_scene as save_scene
from softrod_jax.scene.grid_file import load_grid as load_grid
from softrod_jax.scene.grid_file import save_grid as save_grid
from softrod_jax.scene.loads import Load as Load
from softrod_jax.scene.loads import Marker as Marker
from softrod_jax.scene.loads import Mass as Mass
from softrod_jax.scene.loads import Payload as Payload
from softrod_jax.scene.loads import TipLoad as TipLoad
from softrod_jax.scene.materials import AbstractRubber as AbstractRubber
from softrod_jax.scene.materials import MooneyRivlin as MooneyRivlin
from softrod_jax.scene.materials import NeoHookean as NeoHookean
from softrod_jax.scene.meshes import grid_of_mesh as grid_of_mesh
from softrod_jax.scene.robots import hybrid_robot as hybrid_robot
from softrod_jax.scene.scene import Scene as Scene
from softrod_jax.scene.sections import Annulus as Annulus
from softrod_jax.scene.sections import Circle as Circle
from softrod_jax.scene.sections import GeneralSection as GeneralSection
from softrod_jax.scene.sections import Rectangle as Rectangle
from softrod_jax.scene.segments import Segment as Segment
from softrod_jax.scene.segments import Stiffness as Stiffness
from softrod_jax.scene.silicones import Silicone as Silicone
from softrod_jax.scene.silicones import silicone as silicone
from softrod_jax.scene.tendons import Helix as Helix
from softrod_jax.scene.tendons import Line as Line
from softrod_jax.scene.tendons import Points as Points
from softrod_jax.scene.tendons import Tendons as Tendons
from softrod_jax.static_path import row_of as row_of
from softrod_jax.static_path import solve_path as solve_path
from softrod_jax.statics import StaticSolution as StaticSolution
from softrod_jax.statics import solve_static as solve_static
from softrod_jax.statics import tendon_pulls as tendon_pulls
from softrod_jax.stepping.bdf_alpha import BDFAlpha as BDFAlpha
from softrod_jax.stepping.sdirk import SDIRK as SDIRK
from softrod_jax.viewing import view as view

__version__ = "0.1.0"  # the one place: pyproject.toml reads it

_logging.getLogger(__name__).addHandler(_logging.NullHandler())  # silent until it is asked for
