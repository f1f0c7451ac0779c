"""An independent rod for motions: explicit finite differences, many rods side by side.

It shares no line with `softrod_jax` and needs NumPy alone. Positions are kept at nodes and
frames at the elements between them, as in the discrete elastic rods of Gazzola et al. (2018);
forces are derivatives of a discrete energy, time advances by the leapfrog, and the damping of
bending is implicit. The error is of second order in the spacing and in the step. Stretch and
shear are not damped.

Arrays are (components, rods, nodes or elements); quaternions are (w, x, y, z).
"""

from typing import NamedTuple

import numpy as np


class Rods(NamedTuple):
    """Round or other rods, each entry with one row or number a rod; absent parts are zeros.

    - `L`, `K_se` (rods, 3), `K_bt` (rods, 3), `B_bt` (rods, 3), `rho_A`, `rho_J` (rods, 3).
    - `drag` (rods, 3), `gravity` (rods, 3), `payload`, `force` (rods, 3), `moment` (rods, 3).
    - `offsets` (rods, tendons, 2); `thrust_arm` (rods, 2): chamber offset; `thrust_area`.
    - `curvature` (rods, 3): at rest, in the frame of the section, or None.
    """

    L: np.ndarray
    K_se: np.ndarray
    K_bt: np.ndarray
    B_bt: np.ndarray
    rho_A: np.ndarray
    rho_J: np.ndarray
    drag: np.ndarray
    gravity: np.ndarray
    payload: np.ndarray
    force: np.ndarray
    moment: np.ndarray
    offsets: np.ndarray
    thrust_area: np.ndarray
    thrust_arm: np.ndarray
    curvature: np.ndarray | None = None


def cross(a, b):
    (ax, ay, az), (bx, by, bz) = a, b
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def rotate(q, a):
    w, r = q[0], q[1:]
    t = cross(r, a)
    return a + 2 * (w * t + cross(r, t))


def rotate_back(q, a):
    w, r = q[0], q[1:]
    t = cross(r, a)
    return a - 2 * (w * t - cross(r, t))


def product(a, b):
    w = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3]
    return np.concatenate([w[None], a[0] * b[1:] + b[0] * a[1:] + cross(a[1:], b[1:])])


def exponential(turn):
    half = 0.5 * np.sqrt(np.sum(turn * turn, 0))
    return np.concatenate([np.cos(half)[None], 0.5 * np.sinc(half / np.pi) * turn])


def logarithm(q):
    """The turn of a quaternion with w > 0 or not; exact for turns below a half circle."""
    q = np.where(q[0] < 0, -q, q)
    sine = np.sqrt(np.sum(q[1:] * q[1:], 0))
    angle = np.arctan2(sine, q[0])
    return 2 * q[1:] * np.where(sine < 1e-8, 1.0, angle / np.maximum(sine, 1e-300))


class ExplicitRods:
    """The rods with `n` elements each, at rest from the clamp at 0 along z."""

    def __init__(self, rods: Rods, n: int):
        self.rods, self.n, count = rods, n, len(rods.L)
        up = lambda x: np.moveaxis(np.asarray(x, float), -1, 0)[..., None]  # (3, rods, 1)
        self.h = (rods.L / n)[:, None]
        self.K_se, self.K_bt, self.B_bt = up(rods.K_se), up(rods.K_bt), up(rods.B_bt)
        self.drag, self.gravity = up(rods.drag), up(rods.gravity)
        self.force, self.moment = up(rods.force)[..., 0], up(rods.moment)[..., 0]
        share = np.ones(n + 1)
        share[-1] = 0.5
        self.mass = rods.rho_A[:, None] * self.h * share
        self.mass[:, -1] += rods.payload
        self.J = up(rods.rho_J) * self.h
        # Curvatures belong to the nodes but the last; the clamp's to half an element.
        self.reach = self.h * np.r_[0.5, np.ones(n - 1)]
        z = np.zeros_like(rods.offsets[..., :1])
        r = np.moveaxis(np.concatenate([rods.offsets, z], -1), -1, 0)  # (3, rods, tendons)
        self.r = [r[:, :, i, None] for i in range(r.shape[2])]
        self.thrust_arm = np.stack([rods.thrust_arm[:, 0], rods.thrust_arm[:, 1]])[..., None]
        zero = np.zeros((count, 3))
        self.u_rest = up(zero if rods.curvature is None else rods.curvature)
        middles = (np.arange(n) + 0.5) * self.h
        self.q = exponential(self.u_rest * middles)
        along = rotate(self.q, np.stack([0.0 * middles, 0.0 * middles, 0.0 * middles + self.h]))
        self.x = np.zeros((3, count, n + 1))
        self.x[..., 1:] = np.cumsum(along, -1)
        self.V = np.zeros_like(self.x)
        self.W = np.zeros((3, count, n))
        self.clamp = np.zeros((4, count, 1))
        self.clamp[0] = 1.0

    def longest_step(self):
        """The stable step [s] of each rod, with a margin."""
        rods, h = self.rods, self.h[:, 0]
        fast = np.sqrt(np.max(rods.K_se, 1) / rods.rho_A)
        spin = np.max(rods.K_se[:, :2], 1) / np.min(rods.rho_J[:, :2], 1)
        return 0.7 * 2 / np.sqrt(4 * (fast / h) ** 2 + spin)

    def prepare(self, dt):
        """Fix the steps [s] (rods,): inverses of inertia with the implicit damping."""
        n = self.n
        T = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
        T[0, 0], T[-1, -1] = 3.0, 1.0
        B = self.B_bt[..., 0]
        J = self.J[..., 0]
        h = self.h[:, 0]
        stiff = np.max(B * dt / (J * h), 0) > 1  # (rods,)
        part = np.where(stiff, 1.0, 0.5)
        system = J[..., None, None] * np.eye(n) + (part * dt * B / h)[..., None, None] * T
        self.J_inverse, self.dt = np.linalg.inv(system), dt[:, None]

    def internal(self, tensions, pressure):
        """Forces at the nodes (base frame) and torques of the elements (body frame)."""
        h, q, x = self.h, self.q, self.x
        v = rotate_back(q, (x[..., 1:] - x[..., :-1]) / h)
        before = np.concatenate([self.clamp, q[..., :-1]], -1)
        inverse = np.concatenate([before[:1], -before[1:]])
        turn = logarithm(product(inverse, q))
        u = turn / self.reach
        middle = np.concatenate(
            [
                2 / 3 * u[..., :1] + 1 / 3 * u[..., 1:2],
                0.5 * (u[..., 1:-1] + u[..., 2:]),
                u[..., -1:],
            ],
            -1,
        )
        N = self.K_se * v
        N[2] -= self.K_se[2]
        G = np.zeros_like(N)
        thrust = (pressure * self.rods.thrust_area)[:, None]
        N[2] -= thrust
        G[0] -= self.thrust_arm[1] * thrust
        G[1] += self.thrust_arm[0] * thrust
        for r, tau in zip(self.r, tensions.T):
            path = v + cross(middle, np.broadcast_to(r, middle.shape))
            pull = tau[:, None] * path / np.sqrt(np.sum(path * path, 0))
            N += pull
            G += cross(np.broadcast_to(r, pull.shape), pull)
        # The moments of elements act where their curvatures are measured.
        shared = np.zeros_like(G)
        shared[..., 1:-1] += 0.5 * G[..., 1:-1]
        shared[..., 2:] += 0.5 * G[..., 1:-1]
        shared[..., 0] += 2 / 3 * G[..., 0]
        shared[..., 1] += 1 / 3 * G[..., 0]
        shared[..., -1] += G[..., -1]
        W = self.W
        W_before = np.concatenate([np.zeros_like(W[..., :1]), W[..., :-1]], -1)
        rate = (W - W_before + 0.5 * cross(turn, W + W_before)) / self.reach
        M = self.K_bt * (u - self.u_rest) + self.B_bt * rate + h / self.reach * shared
        bent = 0.5 * cross(turn, M)
        T = h * cross(v, N) - (M - bent)
        T[..., :-1] += (M + bent)[..., 1:]
        n = rotate(q, N)
        F = np.zeros_like(x)
        F[..., :-1] += n
        F[..., 1:] -= n
        return F, T

    def advance(self, tensions, pressure, part=1.0):
        """One step of the leapfrog; `part` 1/2 for the first velocities."""
        F, T = self.internal(tensions, pressure)
        F += self.mass * self.gravity
        V_mid = 0.5 * (self.V[..., 1:] + self.V[..., :-1])
        body = rotate_back(self.q, V_mid)
        resist = 0.5 * self.h * rotate(self.q, self.drag * body * np.abs(body))
        F[..., 1:] -= resist
        F[..., :-1] -= resist
        F[..., -1] += self.force
        tip = self.q[..., -1:]
        T[..., -1] += rotate_back(tip, self.moment[..., None])[..., 0]
        T -= cross(self.W, self.J * self.W)
        self.V[..., 1:] += part * self.dt * (F / self.mass)[..., 1:]
        turned = np.matmul(self.J_inverse, T[..., None])[..., 0]
        self.W += part * self.dt * turned
        self.x += self.dt * self.V
        q = product(self.q, exponential(self.dt * self.W))
        self.q = q / np.sqrt(np.sum(q * q, 0))


def motion(rods: Rods, dt, tensions, pressures, n: int):
    """Tips (rods, steps + 1, 3); inputs (rods, steps, 2, channels): at both ends of each step.

    Within a step inputs are linear; `dt` (rods,).
    """
    model = ExplicitRods(rods, n)
    fine = int(np.max(np.ceil(dt / model.longest_step())))
    model.prepare(dt / fine)
    steps = tensions.shape[1]
    tips = [model.x[..., -1].T.copy()]
    for k in range(steps):
        for j in range(fine):
            taut, pressure = (
                x[:, k, 0] + j / fine * (x[:, k, 1] - x[:, k, 0]) for x in (tensions, pressures)
            )
            model.advance(taut, pressure[:, 0], 0.5 if k == j == 0 else 1.0)
        tips.append(model.x[..., -1].T.copy())
    return np.stack(tips, 1)
