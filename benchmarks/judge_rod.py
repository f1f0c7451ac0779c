"""The rod as the judges see it: rotations, the numbers of a scene, strains from a wrench.

Of the package's scenes only the numbers are read, and none of its code is used. All quantities are
in units of the length L and of the largest bending stiffness EI.
"""

from typing import NamedTuple

import numpy as np

E3 = np.array([0.0, 0.0, 1.0])


class NoAnswer(RuntimeError):
    """The judge found no equilibrium near the start."""


# ------------------------------------------------------------------------------- rotations
def product(a, b):
    """Quaternions (w, x, y, z), (..., 4)."""
    w = a[..., :1] * b[..., :1] - np.sum(a[..., 1:] * b[..., 1:], -1, keepdims=True)
    r = a[..., :1] * b[..., 1:] + b[..., :1] * a[..., 1:] + np.cross(a[..., 1:], b[..., 1:])
    return np.concatenate([w, r], -1)


def conjugate(h):
    return h * np.array([1.0, -1.0, -1.0, -1.0])


def exponential(turn):
    half = np.linalg.norm(turn, axis=-1, keepdims=True) / 2
    return np.concatenate([np.cos(half), 0.5 * np.sinc(half / np.pi) * turn], -1)


def logarithm(h):
    h = h * np.where(h[..., :1] < 0, -1.0, 1.0)
    size = np.linalg.norm(h[..., 1:], axis=-1, keepdims=True)
    angle = 2 * np.arctan2(size, h[..., :1])
    return np.where(size > 1e-9, angle / np.maximum(size, 1e-300), 2.0) * h[..., 1:]


def matrix(h):
    """Rotation matrices (..., 3, 3) of quaternions of any size."""
    w, x, y, z = np.moveaxis(h, -1, 0)
    k = 2 / np.sum(h * h, -1)
    rows = [
        [1 - k * (y * y + z * z), k * (x * y - w * z), k * (x * z + w * y)],
        [k * (x * y + w * z), 1 - k * (x * x + z * z), k * (y * z - w * x)],
        [k * (x * z - w * y), k * (y * z + w * x), 1 - k * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, -1) for row in rows], -2)


def hat(a):
    x, y, z = np.moveaxis(a, -1, 0)
    o = np.zeros_like(x)
    rows = [[o, -z, y], [z, o, -x], [-y, x, o]]
    return np.stack([np.stack(row, -1) for row in rows], -2)


def times(A, b):
    return np.einsum("...ij,...j->...i", A, b)


# ------------------------------------------------------------------------------- the scene
class Rod(NamedTuple):
    """A scene under actuation, in units of L and EI.

    - `length` [m], `clamp` [m], (3,), and `h_base`, (4,), as they are.
    - `k` (6,): stiffnesses for v, then u; `rest` (6,): v*, u*. `inextensible`: v = v*.
    - `tau` (tendons,) and their places `r` (tendons, 3); `thrust` (6,) of the chambers.
    - `weight` per length, `force` with the payload's weight, and `moment`, (3,) each.
    """

    length: float
    clamp: np.ndarray
    h_base: np.ndarray
    k: np.ndarray
    rest: np.ndarray
    inextensible: bool
    tau: np.ndarray
    r: np.ndarray
    thrust: np.ndarray
    weight: np.ndarray
    force: np.ndarray
    moment: np.ndarray


def section_numbers(section):
    """Area, (Ixx, Iyy) and torsion constant: from the outline, where there is one."""
    if hasattr(section, "width"):
        w, h = float(section.width), float(section.height)
        a, b, n = max(w, h), min(w, h), np.arange(1, 4001, 2)
        series = np.sum(np.tanh(n * np.pi * a / (2 * b)) / n**5)
        torsion = a * b**3 * (1 / 3 - 64 / np.pi**5 * b / a * series)
        return w * h, np.array([w * h**3, h * w**3]) / 12, torsion
    if not hasattr(section, "radius") and not hasattr(section, "outer_radius"):
        numbers = section.area, section.second_moments, section.torsion_constant
        return tuple(np.asarray(number, float) for number in numbers)
    outer = float(section.radius if hasattr(section, "radius") else section.outer_radius)
    inner = float(getattr(section, "inner_radius", 0.0))
    I = np.pi * (outer**4 - inner**4) / 4
    return np.pi * (outer**2 - inner**2), np.array([I, I]), 2 * I


def rod_of(scene, tensions=None, pressures=None) -> Rod:
    """From anything with the fields of the package's scenes; only their numbers are read."""
    number = lambda name, default: np.array(
        default if getattr(scene, name) is None else getattr(scene, name), float
    )
    L, E = float(scene.length), float(scene.young_modulus)
    A, I, J = section_numbers(scene.section)
    G = E / (2 * (1 + float(scene.poisson_ratio)))
    EI = E * np.max(I)
    kappa = float(number("shear_correction", 1.0))
    k = np.concatenate([np.array([kappa * G, kappa * G, E]) * A * L**2, [*(E * I), G * J]]) / EI
    rest = np.concatenate([number("rest_stretch", E3), number("rest_curvature", np.zeros(3)) * L])
    in_plane = lambda xy: np.pad(np.asarray(xy, float).reshape(-1, 2), ((0, 0), (0, 1))) / L
    tau, r, thrust = np.zeros(0), np.zeros((0, 3)), np.zeros(6)
    if tensions is not None:
        tau = np.asarray(tensions, float) * L**2 / EI
        r = in_plane(scene.tendons.offsets)
        tau, r = tau[tau != 0], r[tau != 0]
    if pressures is not None:
        push = np.asarray(pressures, float) * np.asarray(scene.chambers.areas) * L**2 / EI
        for p, place in zip(push, in_plane(scene.chambers.offsets), strict=True):
            # The volume per length is A_c e3 . (v + u x r_c).
            thrust += p * np.concatenate([E3, np.cross(place, E3)])
    g = number("gravity", np.zeros(3))
    mass = 0.0 if scene.payload is None else float(scene.payload.mass)

    def load(name):
        value = None if scene.tip_load is None else getattr(scene.tip_load, name)
        return np.zeros(3) if value is None else np.asarray(value, float)

    return Rod(
        length=L,
        clamp=number("base_position", np.zeros(3)),
        h_base=number("base_quaternion", [1.0, 0, 0, 0]),
        k=k,
        rest=rest,
        inextensible=bool(scene.inextensible),
        tau=tau,
        r=r,
        thrust=thrust,
        weight=float(scene.density) * A * g * L**3 / EI,
        force=(load("force") + mass * g) * L**2 / EI,
        moment=load("moment") * L / EI,
    )


# ----------------------------------------------------------------------------- the material
def slopes(rod, x, b):
    """Gradient (..., 6) and second derivatives (..., 6, 6) of the energy at x = (v, u)."""
    g = rod.k * (x - rod.rest) - rod.thrust - b
    H = np.broadcast_to(np.diag(rod.k), (*x.shape, 6)).copy()
    for tau, r in zip(rod.tau, rod.r):
        path = x[..., :3] + np.cross(x[..., 3:], r)
        size = np.linalg.norm(path, axis=-1)[..., None]
        t = path / size
        B = np.concatenate([np.eye(3), -hat(r)], -1)
        g += tau * t @ B
        across = (tau / size)[..., None] * (np.eye(3) - t[..., :, None] * t[..., None, :])
        H += B.T @ across @ B
    return g, H


def energy(rod, x, b):
    e = np.sum((x - rod.rest) ** 2 * rod.k / 2 - (rod.thrust + b) * x, -1)
    for tau, r in zip(rod.tau, rod.r):
        e += tau * np.linalg.norm(x[..., :3] + np.cross(x[..., 3:], r), axis=-1)
    return e


def strains(rod, b, guess):
    """x = (v, u) under the body-frame wrench b, and dx/db: (..., 6) and (..., 6, 6)."""
    free = slice(3 * rod.inextensible, 6)
    if not rod.tau.size:
        soft = np.where(np.arange(6) < free.start, 0.0, 1 / rod.k)
        return rod.rest + soft * (rod.thrust + b), np.broadcast_to(np.diag(soft), (*b.shape, 6))
    x = guess.copy()
    x[..., : free.start] = rod.rest[: free.start]
    weights = np.concatenate([np.ones(3), np.full(3, np.max(np.abs(rod.r)))])
    for _ in range(60):
        g, H = slopes(rod, x, b)
        step = np.zeros_like(x)
        step[..., free] = -np.linalg.solve(H[..., free, free], g[..., free, None])[..., 0]
        size = np.max(np.abs(step) * weights, -1)
        a = np.ones(size.shape)
        if np.max(size) > 1e-4:
            now, slope = energy(rod, x, b), np.sum(step * g, -1)
            for _ in range(30):
                high = energy(rod, x + a[..., None] * step, b) > now + 1e-4 * a * slope
                high &= size > 1e-4
                if not np.any(high):
                    break
                a[high] /= 2
        x = x + a[..., None] * step
        if np.max(size) < 1e-8:
            break
    else:
        raise NoAnswer("a tendon's path has no length left")
    C = np.zeros((*x.shape, 6))
    C[..., free, free] = np.linalg.inv(slopes(rod, x, b)[1][..., free, free])
    return x, C
