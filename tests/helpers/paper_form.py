"""The rod ODE as the paper writes it: (n, m) of the material, tendon and pressure terms spelt out.

Roshanfar et al. (2024), eq. 4 to 12, base frame, signs restored. The oracle of the tests; needs
v_s and u_s, which the total-wrench form does without.
"""

import jax.numpy as jnp

from softrod_jax.rod.rotations import hat, rotation_matrix


def actuation_terms(rod, scene, pressures, v, u, v_s, u_s, R):
    """f_te + f_pr and l_te + l_pr (eq. 7 to 9), base frame."""
    f, l = jnp.zeros(3), jnp.zeros(3)
    e3 = jnp.array([0.0, 0.0, 1.0])
    if rod.tau is not None:
        r_all = rod.r
        for tau, r in zip(rod.tau, r_all, strict=True):
            p_s = hat(u) @ r + v
            A = -tau * hat(p_s) @ hat(p_s) / jnp.linalg.norm(p_s) ** 3
            G = -A @ hat(r)
            H = hat(r) @ G
            a = A @ (hat(u) @ p_s)
            b = hat(r) @ a
            f = f + R @ (a + A @ v_s + G @ u_s)
            l = l + R @ (b + hat(r) @ A @ v_s + H @ u_s)
    if pressures is not None:
        for P, area, (x, y) in zip(
            pressures, scene.chambers.areas, scene.chambers.offsets, strict=True
        ):
            r = jnp.array([x, y, 0.0])
            R_s = R @ hat(u)
            p_c_s = R @ (v + hat(u) @ r)
            f = f - P * area * R_s @ e3
            # l_pr about the axis: offset x distributed force, and the couple of the shear p_s.
            l = l - P * area * (hat(R @ r) @ R_s @ e3 + hat(p_c_s) @ R @ e3)
    return f, l


def material_wrench(rod, v, u, v_t, u_t, R):
    """n and m of the material (eq. 11), base frame."""
    n = rod.K_se * (v - rod.v_star)
    m = rod.K_bt * (u - rod.u_star)
    if rod.B_se is not None:
        n = n + rod.B_se * v_t
    if rod.B_bt is not None:
        m = m + rod.B_bt * u_t
    return R @ n, R @ m


def balance(rod, scene, pressures, h, q, w, q_t, w_t, v, u, v_s, u_s, n):
    """n_s and m_s (eq. 4), base frame."""
    R = rotation_matrix(h)
    f, l = actuation_terms(rod, scene, pressures, v, u, v_s, u_s, R)
    if rod.weight is not None:
        f = f + rod.weight
    if rod.C is not None:
        f = f - R @ (rod.C * q * jnp.abs(q))
    n_s = rod.rho_A * R @ (hat(w) @ q + q_t) - f
    J = rod.rho_J
    m_s = R @ (hat(w) @ (J * w) + J * w_t) - hat(R @ v) @ n - l
    return n_s, m_s
