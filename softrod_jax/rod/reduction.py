"""From a scene with its inputs to the rod's numbers: all that does not change during a solve."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool

from softrod_jax.rod.body import INCOMPLETE, Body, body_along, radius_along
from softrod_jax.rod.carried import Carried, Surroundings
from softrod_jax.rod.constants import PointLoad, Rod
from softrod_jax.rod.contact import ContactForce
from softrod_jax.rod.energies import Part
from softrod_jax.rod.friction import STICK, Friction, unslid
from softrod_jax.rod.given_lengths import given_lengths, per_unit
from softrod_jax.rod.grid import (
    Grid,
    divide,
    divided_grid,
    division_of,
    ends_of_parts,
    gap_of_places,
    places_of,
    uniform_grid,
)
from softrod_jax.rod.own_conditions import with_conditions
from softrod_jax.rod.rotations import to_body
from softrod_jax.scene.acting import AbstractEnergy
from softrod_jax.scene.inputs import Inputs
from softrod_jax.scene.planes import about_normal, angle_in, turn_in, vector_in
from softrod_jax.scene.scene import Scene
from softrod_jax.scene.tendons import driven_by_length, rubbing

# In units of rho ds^2 / E, with ds the distance of points. Smaller ones let the fronts of large
# tensions ring. On the paper's rod at dt = 1 ms this one moves the tip by less than 1e-7 m, whether
# a tendon's 0.1 N jump or 0.3 N rise in 50 ms.
_FRONT_VISCOSITY = 4.0


def make_rod(
    scene: Scene,
    inputs: Inputs = Inputs(),
    dynamic: bool = True,
    grid: Grid | None = None,
    spread_fronts: bool = False,
    around: Surroundings = Surroundings(),
) -> Rod:
    """Reduce `scene` under `inputs`, one value for each actuator.

    `None` for a kind of them leaves it out of the program. `dynamic=False` leaves out what acts on
    a moving rod only (damping, drag). `grid`: the points where numbers that vary along the
    rod are wanted; a few where nothing is said. `spread_fronts`: fronts that tensions send along a
    moving rod are spread over a few points. `around`: where the base and obstacles are that move.
    """
    tensions, pressures, pulls = inputs
    no_tendons = tensions is None and pulls is None
    grid = a_few_points(scene) if grid is None else grid
    plane, stretches = scene.plane, not scene.inextensible
    body = body_along(scene, grid)
    moving = lambda x: x if dynamic else None
    n_ch, m_ch = (None, None) if pressures is None else _chamber_wrench(scene, grid, pressures)
    tau, r, r_s = (None,) * 3 if no_tendons else _tendons(scene, grid, tensions)
    K_se = vector_in(plane, body.K_se) if stretches else None
    front = None
    if not no_tendons and spread_fronts and body.K_se is not None:
        front = _FRONT_VISCOSITY * grid.widest**2 * body.rho_A / body.K_se[..., 2:]
    gravity, load = vector_in(plane, scene.gravity), scene.tip_load
    loads = _distributed_loads(scene, around)
    clamp = clamp_pose(scene) if around.base is None else around.base[:2]
    one, own, damping = jnp.ones(()), (scene.energies, loads), moving(scene.dissipations)
    material, fibres = _law_for_ever(scene, body)
    rod = Rod(
        grid=grid,
        K_se=K_se,
        K_bt=about_normal(plane, body.K_bt),
        v_star=vector_in(plane, body.v_star),
        u_star=turn_in(plane, body.u_star),
        rho_A=body.rho_A,
        rho_J=about_normal(plane, body.rho_J),
        h_base=clamp[1],
        p_base=clamp[0] if any(x.needs_position for x in loads or ()) else None,
        base_velocity=None if around.base is None else _velocity(around.base, plane),
        B_se=moving(vector_in(plane, body.B_se)) if stretches else None,
        B_bt=moving(about_normal(plane, body.B_bt)),
        C=moving(vector_in(plane, body.C)),
        gravity=gravity,
        weight=None if gravity is None else body.rho_A * gravity,
        tau=tau,
        r=vector_in(plane, r),
        r_s=vector_in(plane, r_s),
        front_viscosity=front,
        # A thrust along the rod does no work where it cannot stretch.
        n_ch=vector_in(plane, n_ch) if stretches else None,
        m_ch=turn_in(plane, m_ch),
        payload=None if scene.payload is None else scene.payload.mass,
        F_tip=None if load is None else vector_in(plane, load.force),
        M_tip=None if load is None else turn_in(plane, load.moment),
        at_gaps=_point_loads(scene, grid),
        fibres=fibres,
        relaxation=body.relaxation,
        material=material,
        dissipations=damping,
        energies=scene.energies,
        distributed_loads=loads,
        load_factor=None if own == (None, None) else one,
        s=None if all(x is None for x in (material, damping, *own, scene.conditions)) else grid.s,
        radius=None if scene.contacts is None else radius_along(scene, grid),
        plane=plane,
    )
    rod = rod if dynamic else rod.relaxed
    if not no_tendons:
        rod = _with_tendons_own(scene, rod, pulls)
    if scene.conditions is not None:
        rod = with_conditions(rod, scene.conditions)
    if plane is None:
        return rod
    # Nothing depends on the attitude without dead loads.
    angle = angle_in(plane, rod.h_base) if rod.has_dead_load else jnp.zeros(1)
    return eqx.tree_at(lambda r: r.h_base, rod, angle)


def _law_for_ever(scene: Scene, body: Body):
    """The material of a user and the fibres of rubber, `None` each, as far as they do not relax."""
    material = scene.material if isinstance(scene.material, AbstractEnergy) else None
    fibres, relaxation = body.fibres, body.relaxation
    if relaxation is not None and fibres is not None:
        left = relaxation.left[..., None] * fibres.constants
        fibres = dataclasses.replace(fibres, constants=left)
    if relaxation is not None and material is not None:
        material = Part(material, relaxation.left)
    return material, fibres


def _with_tendons_own(scene: Scene, rod: Rod, pulls) -> Rod:
    """With friction of the tendons, and the lengths that pulls leave to them."""
    assert scene.tendons is not None, INCOMPLETE
    if rubbing(scene.tendons):
        rod = dataclasses.replace(rod, friction=_friction(scene, rod))
    if pulls is None:
        return rod
    there = where_active(scene, rod.grid, scene.tendons)
    lengths = given_lengths(scene.tendons, rod, jnp.asarray(pulls), there)
    return dataclasses.replace(rod, constraint=lengths)


def _distributed_loads(scene: Scene, around: Surroundings):
    """Those of users, and what obstacles do."""
    contacts = scene.contacts or ()
    carried = around.obstacles or (None,) * len(contacts)
    own = map(ContactForce, contacts, carried)
    return (*(scene.distributed_loads or ()), *own) or None


def _velocity(base: Carried, plane: str | None) -> Array:
    """(q, omega) of a clamp."""
    q = to_body(base.quaternion, base.velocity)
    return jnp.concatenate([vector_in(plane, q), turn_in(plane, base.angular_velocity)])


def a_few_points(scene: Scene) -> Grid:
    """Points enough to see every part of a scene's rod."""
    inner, rule = np.zeros(1), np.array([0.5, 0.5])
    division = divide(scene, 2)
    if division is None:
        return uniform_grid(scene.length, 2, inner, np.array([0.5, 1.0, 0.5]))
    return divided_grid(scene, division, inner, rule)


def where_active(scene: Scene, grid: Grid, actuators) -> Bool[Array, "points actuators"] | None:
    """Whether each actuator is there, (points, actuators); `None` where all run along all."""
    if not any(x is not None for x in (*(actuators.starts_at or ()), *(actuators.ends_at or ()))):
        return None
    ends = jnp.stack([jnp.asarray(x, dtype=float) for x in ends_of_parts(scene, division_of(grid))])
    middle = 0.5 * (ends[1:] + ends[:-1])
    parts = [actuators.part(i, scene.length) for i in range(actuators.count)]
    there = jnp.stack([(middle > a) & (middle < b) for a, b in parts], 1)
    return there[division_of(grid).part_of_point(grid.stride)]


def _tendons(scene: Scene, grid: Grid, tensions) -> tuple[Array, Array, Array | None]:
    """Tensions, where they are given, places and slopes."""
    tendons = scene.tendons
    assert tendons is not None, INCOMPLETE
    r, r_s = tendons.routing(grid.s, scene.length)
    there, by_length = where_active(scene, grid, tendons), driven_by_length(tendons)
    if tensions is None:
        tensions = jnp.zeros(tendons.count)
    elif by_length:
        given = [i for i in range(tendons.count) if i not in by_length]
        tensions = jnp.zeros(tendons.count).at[jnp.array(given)].set(tensions)
    return tensions if there is None else jnp.where(there, tensions, 0.0), r, r_s


def _friction(scene: Scene, rod: Rod) -> Friction:
    """Of tendons that have not slid yet."""
    tendons, grid = scene.tendons, rod.grid
    assert tendons is not None and tendons.friction is not None and rod.r is not None, INCOMPLETE
    which = rubbing(tendons)
    own = jnp.array(which)
    r_ss, there = tendons.bends(grid.s, scene.length), where_active(scene, grid, tendons)
    ends = [jnp.asarray(tendons.part(i, scene.length)[1], dtype=float) for i in which]
    chosen = lambda x: None if x is None else x[..., own, :]
    unloaded = per_unit(rod, rod.rest_strain, which)
    unloaded = jnp.broadcast_to(unloaded, (grid.s.shape[0], len(which)))
    return Friction(
        coefficient=jnp.stack([jnp.asarray(tendons.friction[i], dtype=float) for i in which]),
        r=rod.r[..., own, :],
        r_s=chosen(rod.r_s),
        r_ss=chosen(vector_in(scene.plane, r_ss)),
        there=None if there is None else there[:, own],
        to_end=jnp.stack(ends) - grid.s[:, None],
        unloaded=unloaded,
        slid=unslid(unloaded),
        stick=jnp.array(STICK),
        which=which,
    )


def _point_loads(scene: Scene, grid: Grid) -> tuple[PointLoad, ...] | None:
    loads, masses = scene.loads or (), scene.masses or ()
    if not loads and not masses:
        return None
    division, plane = division_of(grid), scene.plane
    at = gap_of_places(scene, division)[len(places_of(scene).values) - len(loads) - len(masses) :]
    here = (at[:, None] == jnp.arange(len(division.gaps))).astype(float)
    forces = [
        PointLoad(k, vector_in(plane, x.force), turn_in(plane, x.moment), frame=x.frame)
        for k, x in zip(here, loads)
    ]
    return (*forces, *(PointLoad(k, mass=x.mass) for k, x in zip(here[len(loads) :], masses)))


def clamp_pose(scene: Scene):
    """Position [m], (3,), and quaternion (w, x, y, z) of the clamp."""
    return (
        _or(scene.base_position, (0.0, 0.0, 0.0)),
        _or(scene.base_quaternion, (1.0, 0.0, 0.0, 0.0)),
    )


def _chamber_wrench(scene: Scene, grid: Grid, pressures):
    """-d/d(v, u) of -sum_c P_c A_c e3.(v + u x r_c): the thrust of the chambers' caps."""
    chambers = scene.chambers
    assert chambers is not None, INCOMPLETE
    thrust = pressures * chambers.areas
    there = where_active(scene, grid, chambers)
    if there is not None:
        thrust = jnp.where(there, thrust, 0.0)
    x, y = chambers.offsets[:, 0], chambers.offsets[:, 1]
    total = jnp.sum(thrust, -1)
    zero = jnp.zeros_like(total)
    n = jnp.stack([zero, zero, total], -1)
    m = jnp.stack([jnp.sum(thrust * y, -1), -jnp.sum(thrust * x, -1), zero], -1)  # r_c x e3
    return n, m


def _or(value, default):
    return jnp.array(default) if value is None else value
