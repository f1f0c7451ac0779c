"""The energy of fibres of rubber: closed forms against fine quadrature, derivatives by hand."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softrod_jax as sr
from softrod_jax.rod.fibres import FibreEnergy, Fibres, fibres_of
from softrod_jax.rod.reduction import make_rod
from softrod_jax.scene.scene import as_arrays

C1, C2 = 6e3, 2e3
R, BORE, HOLE = 6e-3, 2.5e-3, (1.5e-3, 2e-3, -1e-3)
SECTIONS = {
    "circle": sr.Circle(R),
    "annulus": sr.Annulus(R, BORE),
    "rectangle": sr.Rectangle(8e-3, 5e-3),
}
# Columns of (v, u) that are unknown.
FORMS = {
    (None, True): np.arange(6),
    ("xz", True): np.array([0, 2, 4]),
    (None, False): np.array([3, 4, 5]),
    ("xz", False): np.array([4]),
}
# Strains of two points: well bent, with a fibre of a third of its length; and twisted as well.
X = np.array([[0.1, -0.2, 0.9, 60.0, -70.0, 30.0], [0.0, 0.05, 1.4, -25.0, 40.0, -9.0]])


def disk(radius, x=0.0, y=0.0):
    """Places and weights in a disk, exact to rounding for what is smooth."""
    q, w = np.polynomial.legendre.leggauss(60)
    r, angle = radius * np.sqrt((1 + q) / 2), 2 * np.pi * (np.arange(240) + 0.5) / 240
    places = r[:, None, None] * np.stack([np.cos(angle), np.sin(angle)], -1)
    weights = np.pi * radius**2 * np.broadcast_to(w[:, None] / 480, (60, 240))
    return places.reshape(-1, 2) + [x, y], weights.ravel()


def box(width, height):
    q, w = np.polynomial.legendre.leggauss(80)
    places = np.stack(np.meshgrid(width / 2 * q, height / 2 * q, indexing="ij"), -1)
    return places.reshape(-1, 2), width * height / 4 * np.outer(w, w).ravel()


QUADRATURES = {
    "circle": [(*disk(R), 1)],
    "annulus": [(*disk(R), 1), (*disk(BORE), -1)],
    "rectangle": [(*box(8e-3, 5e-3), 1)],
    "hole": [(*disk(R), 1), (*disk(*HOLE), -1)],
}


def fibres(name):
    constants = jnp.array([C1, C2])
    if name != "hole":
        return fibres_of(as_arrays(sr.Scene(1.0, SECTIONS[name])).section, constants)
    disks = jnp.array([[R, 0.0, 0.0, 1.0], [*HOLE, -1.0]])
    return Fibres(constants, disks, jnp.zeros((0, 3)))


def energy_of(name, plane=None, stretches=True):
    rest = jnp.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])[FORMS[plane, stretches]]
    return FibreEnergy(fibres(name), rest, jnp.array(R), stretches, plane)


def moments(name):
    """Area and second moments about x and y."""
    parts = [(sign * w, p) for p, w, sign in QUADRATURES[name]]
    return [sum(w @ f(p) for w, p in parts) for f in (_one, lambda p: p[:, 1] ** 2, _x_squared)]


_one, _x_squared = lambda p: np.ones(len(p)), lambda p: p[:, 0] ** 2


def by_quadrature(name, strain):
    """The energy beyond that of the linear law."""
    l = lambda p: strain[2] + strain[3] * p[:, 1] - strain[4] * p[:, 0]
    psi = lambda l: C1 * (l**2 + 2 / l - 3) + C2 * (2 * l + 1 / l**2 - 3)
    total = sum(sign * w @ psi(l(p)) for p, w, sign in QUADRATURES[name])
    stretch, *bend = strain[2:5] - np.array([1.0, 0.0, 0.0])
    K = 6 * (C1 + C2) * np.array(moments(name))
    return total - 0.5 * K @ np.square([stretch, *bend])


@pytest.mark.parametrize("form", FORMS, ids=["space", "plane", "space, u", "plane, u"])
@pytest.mark.parametrize("name", QUADRATURES)
def test_energy_and_derivatives(name, form):
    plane, stretches = form
    term, columns = energy_of(name, plane, stretches), FORMS[form]
    full = X.copy()
    rest = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    full[:, np.setdiff1d(np.arange(6), columns)] = np.delete(rest, columns)
    x = jnp.array(full[:, columns])
    known = [by_quadrature(name, strain) for strain in full]
    size = 6 * (C1 + C2) * moments(name)[0]
    np.testing.assert_allclose(term.value(x), known, rtol=0, atol=1e-10 * size)
    value = lambda x: term.value(x)
    np.testing.assert_allclose(
        term.gradient(x), jax.vmap(jax.grad(value))(x), rtol=1e-9, atol=1e-12
    )
    hessian = term.hessian(x)
    np.testing.assert_allclose(hessian, jax.vmap(jax.hessian(value))(x), rtol=1e-9, atol=1e-11)


@pytest.mark.parametrize("name", QUADRATURES)
def test_small_strains_are_those_of_the_linear_law(name):
    term = energy_of(name)
    rest, size = term.rest, 6 * (C1 + C2) * np.array(moments(name))
    assert np.abs(term.gradient(rest)).max() < 1e-15 * size[0]
    hessian = np.abs(term.hessian(rest))[2:5, 2:5]
    if name == "hole":  # beside the axis, it couples what the linear law of a rod does not
        hessian = np.diag(np.diag(hessian))
    assert (np.diag(hessian) < 1e-14 * size).all()
    assert hessian.max() < 1e-14 * size[0]


@pytest.mark.parametrize("name", SECTIONS)
@pytest.mark.parametrize("inextensible", [False, True])
def test_stiffness_is_that_of_six_times_the_constants(name, inextensible):
    own = dict(length=1.0, section=SECTIONS[name], density=1e3, inextensible=inextensible)
    linear = dict(young_modulus=6 * (C1 + C2), poisson_ratio=0.5)
    rods = [
        make_rod(as_arrays(sr.Scene(**own, **law)))
        for law in (linear, {"material": sr.MooneyRivlin(C1, C2)})
    ]
    for name in ("K_se", "K_bt"):
        if getattr(rods[0], name) is not None:
            np.testing.assert_allclose(*(getattr(rod, name) for rod in rods), rtol=1e-15)
    neo = sr.Scene(**own, material=sr.NeoHookean(2 * (C1 + C2)))
    np.testing.assert_allclose(make_rod(as_arrays(neo)).K_bt, rods[0].K_bt, rtol=1e-15)


@pytest.mark.parametrize("name", QUADRATURES)
def test_the_shortest_fibre(name):
    places = np.concatenate([p for p, _, sign in QUADRATURES[name] if sign > 0])
    l = X[:, 2:3] + X[:, 3:4] * places[:, 1] - X[:, 4:5] * places[:, 0]
    least = energy_of(name).least_stretch(jnp.array(X))
    assert (least < l.min(-1)).all()
    np.testing.assert_allclose(least, l.min(-1), rtol=0, atol=2e-3)


@pytest.mark.parametrize("name", ["circle", "rectangle"])
def test_sections_that_have_changed_sides_have_no_energy(name):
    term = energy_of(name)
    for strain in ([0.0, 0.0, 0.5, 0.0, 400.0, 0.0], [0.0, 0.0, -0.5, 0.0, 0.0, 0.0]):
        assert np.isnan(term.value(jnp.array([strain]))).all()
        assert np.isnan(term.gradient(jnp.array([strain]))[0, 2])
        assert term.least_stretch(jnp.array(strain)) < 0


def test_a_linear_rod_has_no_fibres():
    linear = sr.Scene(1.0, sr.Circle(R), 1e5, 0.4, 1e3)
    rod = make_rod(as_arrays(linear))
    assert rod.fibres is None and rod.explicit_strains
