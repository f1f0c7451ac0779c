"""Frequencies, damping ratios and shapes against closed forms and an energy method."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from ritz import Ritz

import softrod_jax as sr

METHOD, SMALL = sr.Collocation(16), sr.Collocation(8)
L, R, E, RHO = 0.3, 0.004, 1e6, 1000.0
EI, RHO_A, RHO_I = E * np.pi * R**4 / 4, RHO * np.pi * R**2, RHO * np.pi * R**4 / 4
B = 2e-6


def rod(plane="xz", **parts):
    own = dict(
        length=L, section=sr.Circle(R), young_modulus=E, poisson_ratio=0.45, density=RHO,
        bending_damping=B, inextensible=True, plane=plane,
    )  # fmt: skip
    return sr.Scene(**{**own, **parts})


CASES = {
    "alone": {},
    "payload": dict(payload=0.01),
    "pendulum": dict(payload=0.01, gravity=(0.0, 9.81)),
    "bent": dict(payload=0.002, gravity=(4.0, 0.0), force=(0.0, -0.003)),
}


def scene_of(payload=0.0, gravity=(0.0, 0.0), force=(0.0, 0.0), plane="xz", **parts):
    """All cases have the same parts, and so the same program."""
    in_space = lambda a: jnp.array([a[0], 0.0, a[1]])
    tip = dict(payload=sr.Payload(payload), tip_load=sr.TipLoad(in_space(force)))
    return rod(plane, gravity=in_space(gravity), **tip, **parts)


@pytest.mark.parametrize("name", CASES)
def test_poles_are_those_of_an_energy_method(name):
    found = sr.modes(scene_of(**CASES[name]), count=3, method=METHOD)
    expected = Ritz(L, EI, RHO_A, RHO_I, B, **CASES[name]).poles(3)
    np.testing.assert_allclose(found.eigenvalues, expected, rtol=3e-6)
    np.testing.assert_allclose(found.frequencies, np.abs(expected) / (2 * np.pi), rtol=3e-6)
    ratios = -expected.real / np.abs(expected)
    np.testing.assert_allclose(found.damping_ratios, ratios, rtol=1e-5)


def test_slender_cantilever():
    """Euler and Bernoulli: (beta L)^2 = 3.516, 22.03, 61.70; the ratio is omega B / 2 EI."""
    r = 2e-4 * L
    I, area = np.pi * r**4 / 4, np.pi * r**2
    slender = rod(section=sr.Circle(r), bending_damping=1e-3 * E * I)
    found = sr.modes(slender, count=3, method=METHOD)
    roots = np.array([1.8751040687119611, 4.694091132974175, 7.854757438237613])
    omega = (roots / L) ** 2 * np.sqrt(E * I / (RHO * area))
    np.testing.assert_allclose(2 * np.pi * found.frequencies, omega, rtol=1e-5)
    np.testing.assert_allclose(found.damping_ratios, 0.5e-3 * omega, rtol=1e-5)
    # The shape, with its largest displacement, that of the tip, 1.
    z = found.arc_lengths / L
    for shape, x in zip(found.shapes, roots):
        k = (np.cosh(x) + np.cos(x)) / (np.sinh(x) + np.sin(x))
        w = np.cosh(x * z) - np.cos(x * z) - k * (np.sinh(x * z) - np.sin(x * z))
        np.testing.assert_allclose(shape[:, 0], w / w[-1], atol=1e-5)
        np.testing.assert_allclose(shape[:, 1:], 0.0, atol=1e-9)


def test_relaxing_cantilever():
    """A mode that has omega without relaxation has s^2 + omega^2 (1 - g / (1 + s tau)) = 0."""
    g, tau = 0.4, 0.005
    found = sr.modes(rod(bending_damping=None, relaxation=((g, tau),)), count=3, method=METHOD)
    for omega, pole in zip(np.abs(Ritz(L, EI, RHO_A, RHO_I).poles(2)), found.eigenvalues):
        roots = np.roots([tau, 1.0, omega**2 * tau, omega**2 * (1 - g)])
        np.testing.assert_allclose(pole, roots[np.argmax(roots.imag)], rtol=1e-6)


def test_poles_that_coincide_have_derivatives():
    """Of a round rod in space all are double; without damping, omega goes with the root of E."""

    def of_modulus(E):
        round_rod = rod(None, bending_damping=None, young_modulus=E)
        return sr.modes(round_rod, count=4, method=SMALL).frequencies

    values, slopes = of_modulus(E), jax.jacfwd(of_modulus)(E)
    expected = np.abs(Ritz(L, EI, RHO_A, RHO_I).poles(2)) / (2 * np.pi)
    np.testing.assert_allclose(values, np.repeat(expected, 2), rtol=1e-5)
    np.testing.assert_allclose(values[::2], values[1::2], rtol=1e-9)
    np.testing.assert_allclose(slopes, 0.5 * values / E, rtol=1e-7)


def test_what_buckles_grows():
    """A column 1.3 times as heavy as it can be: one real pole to the right."""
    heavy = dict(gravity=(0.0, -1.3 * 7.837 * EI / (RHO_A * L**3)))
    found = sr.modes(scene_of(**heavy), count=3, method=METHOD)
    expected = Ritz(L, EI, RHO_A, RHO_I, B, **heavy).poles(3)
    assert not found.equilibrium.stats["stable"]
    np.testing.assert_allclose(found.eigenvalues, expected, rtol=1e-5)
    assert np.sum(found.damping_ratios < 0) == 1


def frequencies(z):
    scene = eqx.tree_at(
        lambda s: (s.young_modulus, s.length, s.bending_damping),
        scene_of(**CASES["bent"]),
        (E * z[0], L * z[1], B * z[2]),
    )
    found = sr.modes(scene, count=3, method=METHOD)
    return jnp.concatenate([found.frequencies, found.damping_ratios])


@pytest.mark.long
def test_gradients_are_the_slopes():
    f, one, d = frequencies, jnp.ones(3), 1e-3
    reverse = jax.jacrev(f)(one)
    for i in range(3):
        e = jnp.zeros(3).at[i].set(d)
        slope = (8 * (f(one + e) - f(one - e)) - (f(one + 2 * e) - f(one - 2 * e))) / (12 * d)
        size = np.abs(reverse[:, i]).max()
        np.testing.assert_allclose(reverse[:, i], slope, rtol=1e-6, atol=1e-8 * size)


@pytest.mark.parametrize(
    "tendons, match",
    [
        (dict(friction=(0.1,)), "friction stick"),
        (dict(control="length", backlash=(1e-3,)), "backlash"),
    ],
)
def test_what_has_no_derivative_at_rest_is_refused(tendons, match):
    scene = rod(tendons=sr.Tendons(jnp.array([[2e-3, 0.0]]), **tendons))
    with pytest.raises(ValueError, match=match):
        sr.modes(scene, method=METHOD)


def test_refusals():
    wall = sr.Plane((0.0, 0.0, 0.2), (0.0, 0.0, -1.0))
    rough = rod(None, contacts=[sr.Contact(wall, stiffness=100.0, friction=0.3)])
    with pytest.raises(ValueError, match=r"contacts\[0\] has dry friction"):
        sr.modes(rough, method=METHOD)
    with pytest.raises(ValueError, match="count=1000; this grid has"):
        sr.modes(rod(), count=1000, method=METHOD)
