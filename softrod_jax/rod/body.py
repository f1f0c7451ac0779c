"""What sections and materials are at the points of a grid: stiffness, mass, damping, rest strains.

What is the same along the rod is there once; what varies, by taper or from segment to segment, has
a value for every point.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from softrod_jax.rod.energies import stiffness_at_rest
from softrod_jax.rod.fibres import BOX, DISK, Fibres, fibres_of
from softrod_jax.rod.grid import Grid, division_of, ends_of_parts
from softrod_jax.rod.relaxation import Relaxation
from softrod_jax.scene.acting import AbstractEnergy
from softrod_jax.scene.materials import AbstractRubber
from softrod_jax.scene.scene import Scene
from softrod_jax.scene.sections import Annulus, Circle
from softrod_jax.scene.segments import Segment

# Of what calls have looked for, before they come here.
INCOMPLETE = "the scene has been checked for what it needs"


class Body(NamedTuple):
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
    fibres: Fibres | None = None
    relaxation: Relaxation | None = None


def body_along(scene: Scene, grid: Grid) -> Body:
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
        # A time makes a damping of the stiffness, which differs.
        own |= name in ("B_se", "B_bt") and any(x.damping_time is not None for x in segments)
        values = [getattr(body, name) for body in bodies]
        chosen[name] = _selected(values, number) if own else values[0]
    fibres = _fibres_along([body.fibres for body in bodies], number)
    relaxation = _relaxation_along([body.relaxation for body in bodies], number)
    return Body(**chosen, fibres=fibres, relaxation=relaxation)


def radius_along(scene: Scene, grid: Grid) -> Array:
    """That of round sections [m]; one for each point where it varies."""
    segments, start, radii = scene.parts, 0.0, []
    for segment in segments:
        x = jnp.clip((grid.s - start) / segment.length, 0.0, 1.0)
        section, end = segment.section, segment.section_at_end
        assert isinstance(section, Circle | Annulus), INCOMPLETE
        radii.append(jnp.asarray(section.outline_radius))
        if isinstance(end, Circle | Annulus):
            radii[-1] = (1 - x) * radii[-1] + x * end.outline_radius
        start = start + segment.length
    if len(segments) == 1:
        return radii[0]
    columns = [jnp.reshape(x, (-1, 1)) for x in radii]
    return _chosen(columns, _segment_of_points(scene, grid))[:, 0]


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


def _body(segment: Segment, x: Float[Array, "points"], scene: Scene) -> Body:
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
    fibres, branches = None, segment.relaxation
    if isinstance(segment.material, AbstractRubber):
        constants = segment.material.constants
        of_section = lambda x: fibres_of(segment.section_at(x), constants)
        tapers = segment.section_at_end is not None
        fibres = jax.vmap(of_section)(x) if tapers else of_section(0.0)
    return Body(
        K_se=None if scene.inextensible else K_se,
        K_bt=K_bt,
        v_star=v_star,
        u_star=u_star,
        rho_A=rho_A,
        rho_J=rho_J,
        B_se=_damping(segment, segment.shear_damping, None if scene.inextensible else K_se),
        B_bt=_damping(segment, segment.bending_damping, K_bt),
        C=_diagonal(segment.drag_coefficient),
        fibres=fibres,
        relaxation=None if branches is None else Relaxation(branches[:, 0], branches[:, 1]),
    )


def _segment_of_points(scene: Scene, grid: Grid):
    """The number of the segment that each point is in."""
    ends = jnp.stack([jnp.asarray(x, dtype=float) for x in ends_of_parts(scene, division_of(grid))])
    middle = 0.5 * (ends[1:] + ends[:-1])
    lengths = jnp.stack([segment.length for segment in scene.segments or ()])
    number = jnp.sum(middle[:, None] >= jnp.cumsum(lengths)[:-1], axis=1)
    return number[division_of(grid).part_of_point(grid.stride)]


def _selected(values, number):
    """For each point the value of its segment, zero where it has none; `None` where none has."""
    if all(x is None for x in values):
        return None
    size = next(x.shape[-1:] for x in values if x is not None)
    return _chosen([jnp.zeros(size) if x is None else x for x in values], number)


def _chosen(values: list[Array], number) -> Array:
    chosen: Array | float = 0.0
    for k, x in enumerate(values):
        chosen = jnp.where((number == k)[:, None], x, chosen)
    return jnp.asarray(chosen)


def _fibres_along(fibres: list[Fibres | None], number) -> Fibres | None:
    """Those of all segments; without constants in one that is not of rubber."""
    known = [x for x in fibres if x is not None]
    if not known:
        return None

    def selected(name: str, size: int):
        """Rows of zeros are nothing: every segment gets as many as one has at most."""
        rows = [jnp.zeros((0, size)) if x is None else getattr(x, name) for x in fibres]
        most = max(x.shape[-2] for x in rows)
        more = lambda x: [(0, 0)] * (x.ndim - 2) + [(0, most - x.shape[-2]), (0, 0)]
        flat = [jnp.pad(x, more(x)).reshape(*x.shape[:-2], most * size) for x in rows]
        return jnp.reshape(_chosen(flat, number), (len(number), most, size))

    constants = _chosen([jnp.zeros(2) if x is None else x.constants for x in fibres], number)
    return Fibres(constants, selected("disks", DISK), selected("boxes", BOX))


def _relaxation_along(relaxations: list[Relaxation | None], number) -> Relaxation | None:
    """That of all segments; one with fewer branches has others that are no part of it."""
    known = [x for x in relaxations if x is not None]
    if not known:
        return None
    most = max(x.parts.shape[-1] for x in known)
    filled = []
    for x in relaxations:
        parts, times = (jnp.zeros(0), jnp.zeros(0)) if x is None else (x.parts, x.times)
        more = (0, most - parts.shape[-1])
        filled.append((jnp.pad(parts, more), jnp.pad(times, more, constant_values=1.0)))
    return Relaxation(*(_chosen(list(each), number) for each in zip(*filled)))


def _stiffness_and_mass(segment: Segment, section, scene: Scene):
    """K_se (None if inextensible), K_bt, rho_A and rho_J where this is a segment's section."""
    I = section.second_moments
    rho, rho_A = segment.density, segment.linear_density
    if rho_A is not None:
        rho = rho_A / section.area
    else:
        assert rho is not None, INCOMPLETE
        rho_A = rho * section.area
    measured, material = segment.stiffness, segment.material
    if isinstance(material, AbstractEnergy):
        K_se, K_bt = stiffness_at_rest(material, *segment.rest_strain)
    elif isinstance(material, AbstractRubber):
        K_se, K_bt = _of_moduli(material.young_modulus, 0.5, segment, section, scene)
    elif measured is None:
        E, nu = segment.young_modulus, segment.poisson_ratio
        assert E is not None and nu is not None, INCOMPLETE
        K_se, K_bt = _of_moduli(E, nu, segment, section, scene)
    else:
        K_bt = jnp.append(measured.bending, measured.torsion)
        K_se = None
        if measured.axial is not None and measured.shear is not None:
            K_se = jnp.append(measured.shear, measured.axial)
    return K_se, K_bt, jnp.reshape(rho_A, 1), rho * jnp.stack([I[0], I[1], I[0] + I[1]])


def _of_moduli(E, nu, segment: Segment, section, scene: Scene):
    """K_se, or None if inextensible, and K_bt of an isotropic material."""
    I = section.second_moments
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


def _damping(segment: Segment, value, K: Array | None) -> Array | None:
    """What is given as such, and what a time makes of the stiffness."""
    B, time = _diagonal(value), segment.damping_time
    if time is None or K is None:
        return B
    return time * K if B is None else B + time * K


def _diagonal(value):
    return None if value is None else jnp.broadcast_to(value, (3,))
