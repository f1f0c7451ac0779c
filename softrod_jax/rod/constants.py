"""The rod's numbers: a scene with its actuation, reduced to what the rod equations use.

Everything that does not change along the rod or during a solve is computed here, once.
Absent parts are `None`, so the equations never see them. Of a scene in a plane only what is in the
plane is left: two numbers for a vector and one for a turn (`scene/planes.py`).
"""


import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from softrod_jax.scene.planes import about_normal, angle_in, in_space, turn_in, vector_in
from softrod_jax.scene.scene import Scene
from softrod_jax.scene.tendons import Tendons

Scalar = Float[Array, ""]


class Rod(eqx.Module):
    """Constants of the rod equations (paper eq. 4 to 12; letters as there).

    - `L` [m]; `K_se` [N] and `K_bt` [N m^2]: (3,) diagonals; `v_star`, `u_star`: (3,).
    - `B_se` [N s], `B_bt` [N m^2 s]: (3,) or None. `C` [kg/m^2]: (3,) or None.
    - `rho_A` [kg/m], `rho_J` [kg m]: (3,), rho diag(Ixx, Iyy, Ixx + Iyy).
    - `weight` = rho A g [N/m], (3,), base frame, or None.
    - `tendons` with tensions `tau` [N], (tendons,), or None. `front_viscosity` [s^2]: that of
      the tendons' paths per tension, in a motion; see `constitutive.py`.
    - `n_ch` [N], `m_ch` [N m]: (3,), body frame: -dW_act/d(v, u) of the chambers, or None.
    - `payload` [kg] or None; `gravity` [m/s^2] or None; `F_tip` [N], `M_tip` [N m] or None.
    - `h_base`: quaternion of the clamp, (4,).

    `K_se` is None for an inextensible rod. In a `plane`, (3,) becomes (2,) for v, q, N and (1,)
    for u, omega, M; `h_base` is an angle, (1,).
    """

    L: Scalar
    K_se: Float[Array, "3"] | None
    K_bt: Float[Array, "3"]
    v_star: Float[Array, "3"]
    u_star: Float[Array, "3"]
    rho_A: Scalar
    rho_J: Float[Array, "3"]
    h_base: Float[Array, "4"]
    B_se: Float[Array, "3"] | None = None
    B_bt: Float[Array, "3"] | None = None
    C: Float[Array, "3"] | None = None
    gravity: Float[Array, "3"] | None = None
    weight: Float[Array, "3"] | None = None
    tendons: Tendons | None = None
    tau: Float[Array, "tendons"] | None = None
    front_viscosity: Scalar | None = None
    n_ch: Float[Array, "3"] | None = None
    m_ch: Float[Array, "3"] | None = None
    payload: Scalar | None = None
    F_tip: Float[Array, "3"] | None = None
    M_tip: Float[Array, "3"] | None = None
    plane: str | None = eqx.field(static=True, default=None)

    @property
    def strain_size(self) -> int:
        """Components of the strains: of (v, u), or of u alone."""
        return self.K_bt.size + (0 if self.K_se is None else self.K_se.size)

    def routing(self, s):
        """As that of the tendons, with the components that the rod has."""
        r, r_s = self.tendons.routing(s)
        return vector_in(self.plane, r), vector_in(self.plane, r_s)

    @property
    def has_dead_load(self) -> bool:
        """Whether a load is fixed in the base frame, so that the attitude matters."""
        return any(x is not None for x in (self.gravity, self.F_tip, self.M_tip))


# In units of rho ds^2 / E, with ds the distance of points. Smaller ones let the fronts of large
# tensions ring. On the paper's rod at dt = 1 ms this one moves the tip by less than 1e-7 m, whether
# a tendon's 0.1 N jump or 0.3 N rise in 50 ms.
_FRONT_VISCOSITY = 4.0


def make_rod(
    scene: Scene, tensions=None, pressures=None, dynamic: bool = True, spacing=None
) -> Rod:
    """Reduce `scene` under `tensions` [N] (tendons,) and `pressures` [Pa] (chambers,).

    `None` for either leaves that actuator out of the program. `dynamic=False` leaves out what
    acts on a moving rod only (damping, drag). `spacing` [m], of the points along a moving rod:
    fronts that tensions send along it are spread over a few points.
    """
    area, I = scene.section.area, scene.section.second_moments
    E, plane, stretches = scene.young_modulus, scene.plane, not scene.inextensible
    n_ch, m_ch = (None, None)
    if pressures is not None:
        n_ch, m_ch = _chamber_wrench(scene.chambers, pressures)
    moving = dynamic
    front = None
    if tensions is not None and spacing is not None and stretches:
        front = _FRONT_VISCOSITY * scene.density * spacing**2 / E
    gravity, load = vector_in(plane, scene.gravity), scene.tip_load
    rod = Rod(
        L=scene.length,
        K_se=_stretching_stiffness(scene) if stretches else None,
        K_bt=_bending_stiffness(scene),
        v_star=vector_in(plane, _or(scene.rest_stretch, (0.0, 0.0, 1.0))),
        u_star=turn_in(plane, _or(scene.rest_curvature, (0.0, 0.0, 0.0))),
        rho_A=scene.density * area,
        rho_J=scene.density * _moments(I, plane),
        h_base=clamp_pose(scene)[1],
        B_se=vector_in(plane, _diagonal(scene.shear_damping)) if moving and stretches else None,
        B_bt=about_normal(plane, _diagonal(scene.bending_damping)) if moving else None,
        C=vector_in(plane, _diagonal(scene.drag_coefficient)) if moving else None,
        gravity=gravity,
        weight=None if gravity is None else scene.density * area * gravity,
        tendons=None if tensions is None else scene.tendons,
        tau=tensions,
        front_viscosity=front,
        # A thrust along the rod does no work where it cannot stretch.
        n_ch=vector_in(plane, n_ch) if stretches else None,
        m_ch=turn_in(plane, m_ch),
        payload=None if scene.payload is None else scene.payload.mass,
        F_tip=None if load is None else vector_in(plane, load.force),
        M_tip=None if load is None else turn_in(plane, load.moment),
        plane=plane,
    )
    if plane is None:
        return rod
    # Nothing depends on the attitude without dead loads.
    angle = angle_in(plane, rod.h_base) if rod.has_dead_load else jnp.zeros(1)
    return eqx.tree_at(lambda r: r.h_base, rod, angle)


def _stretching_stiffness(scene: Scene):
    area = scene.section.area
    kGA = scene.shear_modulus * area
    if scene.shear_correction is not None:
        kGA = scene.shear_correction * kGA
    return vector_in(scene.plane, jnp.stack([kGA, kGA, scene.young_modulus * area]))


def _bending_stiffness(scene: Scene):
    E, I = scene.young_modulus, scene.section.second_moments
    if scene.plane is not None:
        return E * about_normal(scene.plane, I)
    GJ = scene.shear_modulus * scene.section.torsion_constant
    return jnp.stack([E * I[0], E * I[1], GJ])


def _moments(I, plane):
    """Second moments about the axes that sections turn about."""
    return jnp.stack([I[0], I[1], I[0] + I[1]]) if plane is None else about_normal(plane, I)


def fastest_wave(rod: Rod) -> Scalar:
    """The speed [m/s] of the fastest wave along the rod: sqrt(E / rho).

    Of stretch or, in an inextensible rod, of short waves of bending, which the inertia of the
    sections holds back.
    """
    if rod.K_se is None:
        return jnp.sqrt(rod.K_bt[0] / rod.rho_J[0])
    return jnp.sqrt(rod.K_se[-1] / rod.rho_A)


def full_strain(strain: Float[Array, "*points n"], rod: Rod) -> Float[Array, "*points 6"]:
    """(v, u) with all components, of the strains that are unknown in this rod."""
    if rod.K_se is None:
        v = jnp.broadcast_to(rod.v_star, (*strain.shape[:-1], rod.v_star.size))
        strain = jnp.concatenate([v, strain], -1)
    return in_space(strain, rod.plane)


def inner_strain(strain: Float[Array, "*points 6"], rod: Rod) -> Float[Array, "*points n"]:
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


def _chamber_wrench(chambers, pressures):
    """-d/d(v, u) of -sum_c P_c A_c e3.(v + u x r_c): the thrust of the chambers' caps."""
    thrust = pressures * chambers.areas
    x, y = chambers.offsets[:, 0], chambers.offsets[:, 1]
    zero = jnp.zeros(())
    n = jnp.stack([zero, zero, jnp.sum(thrust)])
    m = jnp.stack([jnp.sum(thrust * y), -jnp.sum(thrust * x), zero])  # r_c x e3
    return n, m


def _diagonal(value):
    return None if value is None else jnp.broadcast_to(value, (3,))


def _or(value, default):
    return jnp.array(default) if value is None else value
