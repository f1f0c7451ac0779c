"""The rod's numbers: a scene with its actuation, reduced to what the rod equations use.

Everything that does not change during a solve is computed here, once. What is the same along the
rod is there once; what varies has a value for every point of the grid, as the first axis.
Absent parts are `None`, so the equations never see them. Of a scene in a plane only what is in the
plane is left: two numbers for a vector and one for a turn (`scene/planes.py`).
"""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from softrod_jax.rod.energies import stiffness_at_rest
from softrod_jax.rod.grid import (
    Division,
    Grid,
    divide,
    divided_grid,
    ends_of_parts,
    gap_of_places,
    places_of,
    uniform_grid,
)
from softrod_jax.scene.acting import AbstractDistributedLoad, AbstractEnergy
from softrod_jax.scene.inputs import Inputs
from softrod_jax.scene.planes import about_normal, angle_in, in_space, turn_in, vector_in
from softrod_jax.scene.scene import Scene
from softrod_jax.scene.segments import Segment

Scalar = Float[Array, ""]


class PointLoad(eqx.Module):
    """A load or a mass at one place along the rod.

    `F` [N] and `M` [N m]: in the base frame or, with `frame` "body", in that of the section.
    `mass` [kg]. `here`, (gaps,): 1 at the gap between parts where it is, else 0.
    """

    here: Float[Array, "gaps"]
    F: Float[Array, "vector"] | None = None
    M: Float[Array, "turn"] | None = None
    mass: Scalar | None = None
    frame: str = eqx.field(static=True, default="base")


class Rod(eqx.Module):
    """Constants of the rod equations (paper eq. 4 to 12; letters as there).

    Those marked * may vary along the rod, and have then a first axis for the points of the `grid`.

    - `K_se`* [N] and `K_bt`* [N m^2]: (3,) diagonals; `v_star`*, `u_star`*: (3,).
    - `B_se`* [N s], `B_bt`* [N m^2 s]: (3,) or None. `C`* [kg/m^2]: (3,) or None.
    - `rho_A`* [kg/m], (1,); `rho_J`* [kg m]: (3,), rho diag(Ixx, Iyy, Ixx + Iyy).
    - `weight`* = rho A g [N/m], (3,), base frame, or None.
    - `tau`* [N]: tensions, (tendons,), or None, of tendons at `r`* [m], (tendons, 3), with the
      slopes `r_s`*, or None where they are straight. `front_viscosity`* [s^2], (1,): that of the
      tendons' paths per tension, in a motion; see `constitutive.py`.
    - `n_ch`* [N], `m_ch`* [N m]: (3,), body frame: -dW_act/d(v, u) of the chambers, or None.
    - `payload` [kg] or None; `gravity` [m/s^2] or None; `F_tip` [N], `M_tip` [N m] or None.
    - `at_gaps`: loads and masses along the rod.
    - `material`, `energies`, `distributed_loads`: those of users, at arc lengths `s`* [m]; the last
      two times `load_factor`.
    - `h_base`: quaternion of the clamp, (4,). `p_base` [m], (3,): its position, or None where no
      load depends on the position.

    `K_se` is None for an inextensible rod. In a `plane`, a vector (v, q, N) has two components
    instead of three and a turn (u, omega, M) one; `h_base` is an angle, (1,).
    """

    grid: Grid
    K_se: Float[Array, "... vector"] | None
    K_bt: Float[Array, "... turn"]
    v_star: Float[Array, "... vector"]
    u_star: Float[Array, "... turn"]
    rho_A: Float[Array, "... 1"]
    rho_J: Float[Array, "... turn"]
    h_base: Float[Array, "attitude"]
    p_base: Float[Array, "3"] | None = None
    B_se: Float[Array, "... vector"] | None = None
    B_bt: Float[Array, "... turn"] | None = None
    C: Float[Array, "... vector"] | None = None
    gravity: Float[Array, "vector"] | None = None
    weight: Float[Array, "... vector"] | None = None
    tau: Float[Array, "... tendons"] | None = None
    r: Float[Array, "... tendons vector"] | None = None
    r_s: Float[Array, "... tendons vector"] | None = None
    front_viscosity: Float[Array, "... 1"] | None = None
    n_ch: Float[Array, "... vector"] | None = None
    m_ch: Float[Array, "... turn"] | None = None
    payload: Scalar | None = None
    F_tip: Float[Array, "vector"] | None = None
    M_tip: Float[Array, "turn"] | None = None
    at_gaps: tuple[PointLoad, ...] | None = None
    material: AbstractEnergy | None = None
    energies: Sequence[AbstractEnergy] | None = None
    distributed_loads: Sequence[AbstractDistributedLoad] | None = None
    load_factor: Scalar | None = None
    s: Float[Array, "points"] | None = None
    plane: str | None = eqx.field(static=True, default=None)

    @property
    def L(self) -> Scalar:
        """The length [m]."""
        return self.grid.length

    @property
    def mass(self) -> Scalar:
        """That of the rod itself [kg]."""
        if self.rho_A.ndim == 1:
            return self.rho_A[0] * self.L
        return self.grid.weights @ self.rho_A[:, 0]

    @property
    def strain_size(self) -> int:
        """Components of the strains: of (v, u), or of u alone."""
        return self.K_bt.shape[-1] + (0 if self.K_se is None else self.K_se.shape[-1])

    @property
    def explicit_strains(self) -> bool:
        """Whether the energy is quadratic: strains then follow without iterations."""
        return self.tau is None and self.material is None and self.energies is None

    @property
    def reach(self) -> Scalar:
        """The radius [m] of a round section that is as stiff."""
        if self.K_se is None:
            return self.L
        return 2 * jnp.sqrt(jnp.max(self.K_bt[..., 0]) / jnp.max(self.K_se[..., -1]))

    @property
    def has_dead_load(self) -> bool:
        """Whether a load is fixed in the base frame, so that the attitude matters."""
        if self.distributed_loads is not None:
            return True
        gaps = self.at_gaps or ()
        along = [x.F if x.F is not None else x.M for x in gaps if x.frame == "base"]
        return any(x is not None for x in (self.gravity, self.F_tip, self.M_tip, *along))

    def map_points(self, function) -> "Rod":
        """The rod with `function` of everything that varies along it: (points, ...) to (m, ...)."""
        own = {name: getattr(self, name) for name in _AXES}
        names = [n for n, x in own.items() if x is not None and x.ndim > _AXES[n]]
        if not names:
            return self
        pick = lambda rod: [getattr(rod, name) for name in names]
        return eqx.tree_at(pick, self, [function(x) for x in pick(self)])


# Of what calls have looked for, before they come here.
INCOMPLETE = "the scene has been checked for what it needs"

# How many axes what may vary has where it does not.
_AXES = {
    **dict.fromkeys(("K_se", "K_bt", "v_star", "u_star", "rho_A", "rho_J", "B_se", "B_bt", "C"), 1),
    **dict.fromkeys(("weight", "tau", "front_viscosity", "n_ch", "m_ch"), 1),
    **dict.fromkeys(("r", "r_s"), 2),
    "s": 0,
}

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
) -> Rod:
    """Reduce `scene` under `inputs`, one value for each actuator.

    `None` for a kind of them leaves it out of the program. `dynamic=False` leaves out what acts on
    a moving rod only (damping, drag). `grid`: the points where numbers that vary along the
    rod are wanted; a few where nothing is said. `spread_fronts`: fronts that tensions send along a
    moving rod are spread over a few points.
    """
    tensions, pressures = inputs
    grid = a_few_points(scene) if grid is None else grid
    plane, stretches = scene.plane, not scene.inextensible
    body = _along(scene, grid)
    moving = lambda x: x if dynamic else None
    n_ch, m_ch = (None, None) if pressures is None else _chamber_wrench(scene, grid, pressures)
    tau, r, r_s = (None,) * 3 if tensions is None else _tendons(scene, grid, tensions)
    K_se = vector_in(plane, body.K_se) if stretches else None
    front = None
    if tensions is not None and spread_fronts and body.K_se is not None:
        front = _FRONT_VISCOSITY * grid.widest**2 * body.rho_A / body.K_se[..., 2:]
    gravity, load = vector_in(plane, scene.gravity), scene.tip_load
    own, one = (scene.material, scene.energies, scene.distributed_loads), jnp.ones(())
    rod = Rod(
        grid=grid,
        K_se=K_se,
        K_bt=about_normal(plane, body.K_bt),
        v_star=vector_in(plane, body.v_star),
        u_star=turn_in(plane, body.u_star),
        rho_A=body.rho_A,
        rho_J=about_normal(plane, body.rho_J),
        h_base=clamp_pose(scene)[1],
        p_base=clamp_pose(scene)[0] if _position_matters(scene) else None,
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
        material=scene.material,
        energies=scene.energies,
        distributed_loads=scene.distributed_loads,
        load_factor=None if scene.energies is None and scene.distributed_loads is None else one,
        s=None if all(x is None for x in own) else grid.s,
        plane=plane,
    )
    if plane is None:
        return rod
    # Nothing depends on the attitude without dead loads.
    angle = angle_in(plane, rod.h_base) if rod.has_dead_load else jnp.zeros(1)
    return eqx.tree_at(lambda r: r.h_base, rod, angle)


def _position_matters(scene: Scene) -> bool:
    return any(load.needs_position for load in scene.distributed_loads or ())


def a_few_points(scene: Scene) -> Grid:
    """Points enough to see every part of a scene's rod."""
    inner = np.zeros(1)
    division = divide(scene, 2)
    if division is None:
        return uniform_grid(scene.length, 2, inner)
    return divided_grid(scene, division, inner)


class _Body(NamedTuple):
    """What a section and its material are, all components; along the rod where it varies."""

    K_se: Array | None
    K_bt: Array
    v_star: Array
    u_star: Array
    rho_A: Array
    rho_J: Array
    B_se: Array | None
    B_bt: Array | None
    C: Array | None


def _along(scene: Scene, grid: Grid) -> _Body:
    segments = scene.parts
    start, bodies = 0.0, []
    for segment in segments:
        x = (grid.s - start) / segment.length
        bodies.append(_body(segment, jnp.clip(x, 0.0, 1.0), scene))
        start = start + segment.length
    if len(segments) == 1:
        return bodies[0]
    number = _segment_of_points(scene, grid)
    chosen = {}
    for name, source in _SOURCES.items():
        own = source is None or any(
            getattr(x, source) is not getattr(segments[0], source) for x in segments
        )
        values = [getattr(body, name) for body in bodies]
        chosen[name] = _selected(values, number) if own else values[0]
    return _Body(**chosen)


# From what segments may share it follows; those of sections and materials differ.
_SOURCES = {
    "K_se": None,
    "K_bt": None,
    "v_star": "rest_stretch",
    "u_star": "rest_curvature",
    "rho_A": None,
    "rho_J": None,
    "B_se": "shear_damping",
    "B_bt": "bending_damping",
    "C": "drag_coefficient",
}


def _body(segment: Segment, x: Float[Array, "points"], scene: Scene) -> _Body:
    """The numbers of a segment; `x`: the parts of its length at which the points are."""

    def at(x):
        """Of a section whose dimensions change linearly."""
        mix = lambda a, b: (1 - x) * a + x * b
        section = jax.tree.map(mix, segment.section, segment.section_at_end)
        return _stiffness_and_mass(segment, section, scene)

    if segment.section_at_end is None:
        K_se, K_bt, rho_A, rho_J = _stiffness_and_mass(segment, segment.section, scene)
    else:
        K_se, K_bt, rho_A, rho_J = jax.vmap(at)(x)
    v_star, u_star = segment.rest_strain
    return _Body(
        K_se=None if scene.inextensible else K_se,
        K_bt=K_bt,
        v_star=v_star,
        u_star=u_star,
        rho_A=rho_A,
        rho_J=rho_J,
        B_se=_diagonal(segment.shear_damping),
        B_bt=_diagonal(segment.bending_damping),
        C=_diagonal(segment.drag_coefficient),
    )


def _segment_of_points(scene: Scene, grid: Grid):
    """The number of the segment that each point is in."""
    ends = jnp.stack([jnp.asarray(x, dtype=float) for x in _ends(scene, grid)])
    middle = 0.5 * (ends[1:] + ends[:-1])
    lengths = jnp.stack([segment.length for segment in scene.segments or ()])
    number = jnp.sum(middle[:, None] >= jnp.cumsum(lengths)[:-1], axis=1)
    return number[_division(grid).part_of_point(grid.stride)]


def _ends(scene: Scene, grid: Grid) -> list:
    return ends_of_parts(scene, _division(grid))


def _division(grid: Grid) -> Division:
    if grid.division is None:
        raise ValueError(
            "this method along the rod has no nodes where segments, tendons or chambers end; "
            "use Collocation"
        )
    return grid.division


def _selected(values, number):
    """For each point the value of its segment."""
    if all(x is None for x in values):
        return None
    size = next(x.shape[-1:] for x in values if x is not None)
    chosen = 0.0
    for k, x in enumerate(values):
        x = jnp.zeros(size) if x is None else x
        chosen = jnp.where((number == k)[:, None], x, chosen)
    return chosen


def _stiffness_and_mass(segment: Segment, section, scene: Scene):
    """K_se (None if inextensible), K_bt, rho_A and rho_J where this is a segment's section."""
    I = section.second_moments
    rho, rho_A = segment.density, segment.linear_density
    if rho_A is not None:
        rho = rho_A / section.area
    else:
        assert rho is not None, INCOMPLETE
        rho_A = rho * section.area
    measured, material = segment.stiffness, scene.material
    if material is not None:
        K_se, K_bt = stiffness_at_rest(material, *segment.rest_strain)
    elif measured is None:
        K_se, K_bt = _of_moduli(segment, section, scene)
    else:
        K_bt = jnp.append(measured.bending, measured.torsion)
        K_se = None
        if measured.axial is not None and measured.shear is not None:
            K_se = jnp.append(measured.shear, measured.axial)
    return K_se, K_bt, jnp.reshape(rho_A, 1), rho * jnp.stack([I[0], I[1], I[0] + I[1]])


def _of_moduli(segment: Segment, section, scene: Scene):
    """K_se, or None if inextensible, and K_bt of an isotropic material."""
    E, nu, I = segment.young_modulus, segment.poisson_ratio, section.second_moments
    assert E is not None and nu is not None, INCOMPLETE
    if scene.inextensible and scene.plane is not None:
        # Nothing is sheared or twisted: the shear modulus is in no equation.
        return None, jnp.stack([E * I[0], E * I[1], jnp.zeros(())])
    G = E / (2 * (1 + nu))
    K_bt = jnp.stack([E * I[0], E * I[1], G * section.torsion_constant])
    if scene.inextensible:
        return None, K_bt
    kGA = G * section.area
    if segment.shear_correction is not None:
        kGA = segment.shear_correction * kGA
    return jnp.stack([kGA, kGA, E * section.area]), K_bt


def _active(scene: Scene, grid: Grid, actuators):
    """Whether each actuator is there, (points, actuators); `None` where all run along all."""
    if not any(x is not None for x in (*(actuators.starts_at or ()), *(actuators.ends_at or ()))):
        return None
    ends = jnp.stack([jnp.asarray(x, dtype=float) for x in _ends(scene, grid)])
    middle = 0.5 * (ends[1:] + ends[:-1])
    parts = [actuators.part(i, scene.length) for i in range(actuators.count)]
    there = jnp.stack([(middle > a) & (middle < b) for a, b in parts], 1)
    return there[_division(grid).part_of_point(grid.stride)]


def _tendons(scene: Scene, grid: Grid, tensions) -> tuple[Array, Array, Array | None]:
    """Tensions, places and slopes."""
    assert scene.tendons is not None, INCOMPLETE
    r, r_s = scene.tendons.routing(grid.s, scene.length)
    there = _active(scene, grid, scene.tendons)
    return tensions if there is None else jnp.where(there, tensions, 0.0), r, r_s


def _point_loads(scene: Scene, grid: Grid) -> tuple[PointLoad, ...] | None:
    loads, masses = scene.loads or (), scene.masses or ()
    if not loads and not masses:
        return None
    division, plane = _division(grid), scene.plane
    at = gap_of_places(scene, division)[len(places_of(scene).values) - len(loads) - len(masses) :]
    here = (at[:, None] == jnp.arange(len(division.gaps))).astype(float)
    forces = [
        PointLoad(k, vector_in(plane, x.force), turn_in(plane, x.moment), frame=x.frame)
        for k, x in zip(here, loads)
    ]
    return (*forces, *(PointLoad(k, mass=x.mass) for k, x in zip(here[len(loads) :], masses)))


def fastest_wave(rod: Rod) -> Scalar:
    """The speed [m/s] of the fastest wave along the rod: sqrt(E / rho).

    Of stretch or, in an inextensible rod, of short waves of bending, which the inertia of the
    sections holds back.
    """
    if rod.K_se is None:
        return jnp.sqrt(jnp.max(rod.K_bt[..., 0] / rod.rho_J[..., 0]))
    return jnp.sqrt(jnp.max(rod.K_se[..., -1] / rod.rho_A[..., 0]))


def full_strain(strain: Float[Array, "*points unknown"], rod: Rod) -> Float[Array, "*points 6"]:
    """(v, u) with all components, of the strains that are unknown in this rod."""
    if rod.K_se is None:
        v = jnp.broadcast_to(rod.v_star, (*strain.shape[:-1], rod.v_star.shape[-1]))
        strain = jnp.concatenate([v, strain], -1)
    return in_space(strain, rod.plane)


def inner_strain(strain: Float[Array, "*points 6"], rod: Rod) -> Float[Array, "*points unknown"]:
    """The strains that are unknown in this rod, of (v, u)."""
    u = turn_in(rod.plane, strain[..., 3:])
    if rod.K_se is None:
        return u
    return (
        strain
        if rod.plane is None
        else jnp.concatenate([vector_in(rod.plane, strain[..., :3]), u], -1)
    )


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
    there = _active(scene, grid, chambers)
    if there is not None:
        thrust = jnp.where(there, thrust, 0.0)
    x, y = chambers.offsets[:, 0], chambers.offsets[:, 1]
    total = jnp.sum(thrust, -1)
    zero = jnp.zeros_like(total)
    n = jnp.stack([zero, zero, total], -1)
    m = jnp.stack([jnp.sum(thrust * y, -1), -jnp.sum(thrust * x, -1), zero], -1)  # r_c x e3
    return n, m


def _diagonal(value):
    return None if value is None else jnp.broadcast_to(value, (3,))


def _or(value, default):
    return jnp.array(default) if value is None else value
