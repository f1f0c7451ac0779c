"""The rod's numbers: a scene with its actuation, reduced to what the rod equations use.

Everything that does not change along the rod or during a solve is computed here, once.
Absent parts are `None`, so the equations never see them.
"""

from typing import Optional

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from softrod_jax.scene import Scene, Tendons

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
    """

    L: Scalar
    K_se: Float[Array, "3"]
    K_bt: Float[Array, "3"]
    v_star: Float[Array, "3"]
    u_star: Float[Array, "3"]
    rho_A: Scalar
    rho_J: Float[Array, "3"]
    h_base: Float[Array, "4"]
    B_se: Optional[Float[Array, "3"]] = None
    B_bt: Optional[Float[Array, "3"]] = None
    C: Optional[Float[Array, "3"]] = None
    gravity: Optional[Float[Array, "3"]] = None
    weight: Optional[Float[Array, "3"]] = None
    tendons: Optional[Tendons] = None
    tau: Optional[Float[Array, "tendons"]] = None
    front_viscosity: Optional[Scalar] = None
    n_ch: Optional[Float[Array, "3"]] = None
    m_ch: Optional[Float[Array, "3"]] = None
    payload: Optional[Scalar] = None
    F_tip: Optional[Float[Array, "3"]] = None
    M_tip: Optional[Float[Array, "3"]] = None

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
    area, I, J_t = (
        scene.section.area,
        scene.section.second_moments,
        scene.section.torsion_constant,
    )
    E, G = scene.young_modulus, scene.shear_modulus
    kGA = G * area if scene.shear_correction is None else scene.shear_correction * G * area
    n_ch, m_ch = (None, None)
    if pressures is not None:
        n_ch, m_ch = _chamber_wrench(scene.chambers, pressures)
    moving = dynamic
    front = None
    if tensions is not None and spacing is not None:
        front = _FRONT_VISCOSITY * scene.density * spacing**2 / E
    return Rod(
        L=scene.length,
        K_se=jnp.stack([kGA, kGA, E * area]),
        K_bt=jnp.stack([E * I[0], E * I[1], G * J_t]),
        v_star=_or(scene.rest_stretch, (0.0, 0.0, 1.0)),
        u_star=_or(scene.rest_curvature, (0.0, 0.0, 0.0)),
        rho_A=scene.density * area,
        rho_J=scene.density * jnp.stack([I[0], I[1], I[0] + I[1]]),
        h_base=clamp_pose(scene)[1],
        B_se=_diagonal(scene.shear_damping) if moving else None,
        B_bt=_diagonal(scene.bending_damping) if moving else None,
        C=_diagonal(scene.drag_coefficient) if moving else None,
        gravity=scene.gravity,
        weight=None if scene.gravity is None else scene.density * area * scene.gravity,
        tendons=None if tensions is None else scene.tendons,
        tau=tensions,
        front_viscosity=front,
        n_ch=n_ch,
        m_ch=m_ch,
        payload=None if scene.payload is None else scene.payload.mass,
        F_tip=None if scene.tip_load is None else scene.tip_load.force,
        M_tip=None if scene.tip_load is None else scene.tip_load.moment,
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
