"""What can be fitted: numbers of a scene and of the bench around it, each with unit and scale.

An optimiser sees one coordinate theta for each parameter, see `calibration.parameters.scales`. A
damping or drag of x, y and z is scaled as a whole: one recording seldom tells its components apart.
The others with components are fitted one by one: `sensor_offset` stands for `sensor_offset_x`,
`sensor_offset_y` and `sensor_offset_z`, `tendon_efficiency_1` is that of the first tendon.
"""

from collections.abc import Callable, Iterable
from difflib import get_close_matches

import equinox as eqx
import jax.numpy as jnp
import numpy as np

import softrod_jax as sr
from calibration.experiment.setup import Setup
from calibration.parameters.modulus import Modulus, is_rubber
from calibration.parameters.names import NAMES
from calibration.parameters.parameter import AbstractParameter, Parameter
from calibration.parameters.paths import is_path, path_parameter
from calibration.parameters.scales import Between, Factor, Shift
from softrod_jax.scene.inputs import KINDS
from softrod_jax.scene.placement import outside_sections
from softrod_jax.scene.tendons import rubbing


def as_names(names: Iterable[str] | str) -> tuple[str, ...]:
    """Names that were given one by one, or a single one."""
    return (names,) if isinstance(names, str) else tuple(names)


DEFAULT = ("young_modulus", "bending_damping", "drag_coefficient")
# What matters of a place on the bench, of one in the section, and of an angle.
_ON_THE_BENCH = Shift(1e-3)  # m
_IN_THE_SECTION = Shift(2e-4)  # m
_RELEASE = 0.03  # s, where the search for a release's duration starts
_ANGLE = Shift(float(np.pi / 180))  # rad
_LAG = 0.03  # s, where the search for that of a valve or servo starts
_HAND = Shift(0.1), Shift(1e-2)  # N and N m, of a hand that holds a tip
_GAINS = Shift(0.5), Shift(2.0)  # of thrust over pressure, by bar and by bar squared


def _scene(name: str) -> Callable:
    return lambda setup: getattr(setup.scene, name)


def _length(setup: Setup):
    """That of the rod; segments have lengths of their own."""
    return setup.scene.length if setup.scene.segments is None else None


def _part(part: str, name: str) -> Callable:
    def find(setup):
        owner = getattr(setup.scene, part)
        return None if owner is None else getattr(owner, name)

    return find


def _in_section(part: str) -> Callable:
    """Whether all tendons or chambers of a setup are within the sections, or need not be."""

    def inside(setup: Setup) -> bool:
        return not any(key.startswith(part) for key, _, _ in outside_sections(setup.scene))

    return inside


def _maker(find: Callable, value: Callable) -> Callable:
    """Puts `value()` where `find` finds None."""
    return lambda setup: eqx.tree_at(find, setup, value(), is_leaf=lambda x: x is None)


# A parameter, and the name of the group that stands for it and its like, if there is one.
_Entry = tuple[str | None, AbstractParameter]


def catalogue(
    scene: sr.Scene,
) -> tuple[dict[str, AbstractParameter], dict[str, tuple[str, ...]]]:
    """Every parameter of `scene` by name, and groups of them by the name of the group."""
    entries = [
        *((None, parameter) for parameter in _of_any_scene()),
        *_of_material(scene),
        *_of_tendons(scene),
        *_of_chambers(scene),
        *_between_command_and_robot(scene),
        *_of_the_bench(scene),
    ]
    groups: dict[str, tuple[str, ...]] = {}
    for group, parameter in entries:
        if group is not None:
            groups[group] = (*groups.get(group, ()), parameter.name)
    return {parameter.name: parameter for _, parameter in entries}, groups


def _of_any_scene() -> list[AbstractParameter]:
    """The parameters that a scene may have whatever its actuators are."""
    return [
        Modulus("young_modulus", "Pa", remedy="rod.young_modulus"),
        Parameter(
            "bending_damping", "N m^2 s", _scene("bending_damping"), remedy="rod.bending_damping"
        ),
        Parameter(
            "drag_coefficient", "kg/m^2", _scene("drag_coefficient"), remedy="rod.drag_coefficient"
        ),
        Parameter("shear_damping", "N s", _scene("shear_damping"), remedy="rod.shear_damping"),
        Parameter("damping_time", "s", _scene("damping_time"), remedy="rod.damping_time"),
        Parameter("poisson_ratio", "1", _scene("poisson_ratio"), scale=Between(-1.0, 0.5)),
        Parameter("density", "kg/m^3", _scene("density")),
        Parameter("length", "m", _length, remedy="rod.length"),
        Parameter(
            "shear_correction", "1", _scene("shear_correction"), remedy="rod.shear_correction"
        ),
        Parameter(
            "payload_mass",
            "kg",
            _part("payload", "mass"),
            make=_maker(lambda s: s.scene.payload, lambda: sr.Payload(jnp.zeros(()))),
            remedy="[payload] mass",
        ),
        Parameter("chamber_area", "m^2", _part("chambers", "areas"), remedy="[[chambers]]"),
        Parameter(
            "tendon_offset",
            "m",
            _part("tendons", "offsets"),
            remedy="[[tendons]]",
            allowed=_in_section("tendons"),
        ),
    ]


def _of_material(scene: sr.Scene) -> list[_Entry]:
    """The constants of rubber, what was measured instead of moduli, and branches that relax."""
    found: list[_Entry] = []
    for part, unit in (
        *(("material.c1", "Pa"), ("material.c2", "Pa"), ("material.mu", "Pa")),
        *(("stiffness.bending", "N m^2"), ("stiffness.torsion", "N m^2")),
        *(("stiffness.axial", "N"), ("stiffness.shear", "N")),
    ):
        owner, key = part.split(".")
        if getattr(getattr(scene, owner), key, None) is not None:
            found.append((None, Parameter(f"{owner}_{key}", unit, _part(owner, key))))
    if scene.relaxation is None:
        return found
    branches = range(np.shape(scene.relaxation)[0])
    for name, column, unit, scale in (
        ("relaxation_part", 0, "1", Between(0.0, 1.0)),
        ("relaxation_time", 1, "s", Factor()),
    ):
        indices = {str(j + 1): (j, column) for j in branches}
        found += _group(name, unit, _scene("relaxation"), scale, indices)
    return found


def _of_tendons(scene: sr.Scene) -> list[_Entry]:
    count = 0 if scene.tendons is None else scene.tendons.count
    if not count:
        return []
    offsets, inside = _part("tendons", "offsets"), _in_section("tendons")
    driven = {kind.name: kind.count(scene) for kind in KINDS}
    found = _group("tendon_position", "m", offsets, _IN_THE_SECTION, _xy(count), allowed=inside)
    if by_tension := driven["tensions"]:
        efficiency = lambda setup: setup.tendon_efficiency
        ones = _maker(efficiency, lambda: jnp.ones(by_tension))
        number = _numbered(by_tension)
        found += _group("tendon_efficiency_each", "1", efficiency, Factor(), number, ones)
        found.append((None, Parameter("tendon_efficiency", "1", efficiency, make=ones)))
    named = [("tendon_friction", "friction", "1")]
    if driven["pulls"]:
        named.append(("tendon_stiffness", "stiffness", "N/m"))
        named += [("pretension", "pretension", "N"), ("backlash", "backlash", "m")]
    for name, key, unit in named:
        remedy = f"[[tendons]] {key}"
        found.append((None, Parameter(name, unit, _part("tendons", key), remedy=remedy)))
    if by_length := driven["pulls"]:
        gain, offset = (lambda setup: setup.pull_gain), (lambda setup: setup.pull_offset)
        ones = _maker(gain, lambda: jnp.ones(by_length))
        none = _maker(offset, lambda: jnp.zeros(by_length))
        number = _numbered(by_length)
        found.append((None, Parameter("pull_gain", "1", gain, make=ones)))
        found += _group("pull_gain_each", "1", gain, Factor(), number, ones)
        found += _group("pull_offset", "m", offset, _IN_THE_SECTION, number, none)
    rubs = {str(i + 1): i for i in rubbing(scene.tendons)}
    return found + _group("tendon_friction_each", "1", _part("tendons", "friction"), Factor(), rubs)


def _of_chambers(scene: sr.Scene) -> list[_Entry]:
    count = 0 if scene.chambers is None else scene.chambers.count
    if not count:
        return []
    centres, inside = _part("chambers", "offsets"), _in_section("chambers")
    areas = _part("chambers", "areas")
    return [
        *_group("chamber_position", "m", centres, _IN_THE_SECTION, _xy(count), allowed=inside),
        *_group("chamber_area_each", "m^2", areas, Factor(), _numbered(count)),
    ]


def _between_command_and_robot(scene: sr.Scene) -> list[_Entry]:
    """The lags of valves and servos, and how thrust grows with pressure."""
    found: list[_Entry] = []
    for kind in KINDS:
        if kind.count(scene):
            name = f"{kind.one}_lag"
            find = lambda setup, name=name: getattr(setup, name)
            make = _maker(find, lambda: jnp.array(_LAG))
            found.append((None, Parameter(name, "s", find, make=make)))
    if scene.chambers is not None and scene.chambers.count:
        gain = lambda setup: setup.pressure_gain
        make = _maker(gain, lambda: jnp.zeros(2))
        for k, unit in enumerate(("1/bar", "1/bar^2")):
            own = {str(k + 1): k}
            found += _group("pressure_gain", unit, gain, _GAINS[k], own, make)
    return found


def _of_the_bench(scene: sr.Scene) -> list[_Entry]:
    """The parameters of what surrounds the robot: the hand that lets go, sensor, clamp, gravity."""
    found: list[_Entry] = []
    if scene.gravity is not None and scene.tendons is None:
        duration = lambda setup: setup.release_duration
        make = _maker(duration, lambda: jnp.array(_RELEASE))
        found.append((None, Parameter("release_duration", "s", duration, make=make)))
    weighs = scene.gravity is not None
    for name, unit, scale, there in (
        ("hand_force", "N", _HAND[0], True),
        ("hand_moment", "N m", _HAND[1], True),
        ("sensor_offset", "m", _ON_THE_BENCH, True),
        ("payload_offset", "m", _ON_THE_BENCH, weighs and scene.payload is not None),
        ("gravity_tilt", "rad", _ANGLE, weighs),
        ("clamp_rotation", "rad", _ANGLE, True),
        ("clamp_shift", "m", _ON_THE_BENCH, True),
        ("camera_rotation", "rad", _ANGLE, True),
        ("camera_shift", "m", _ON_THE_BENCH, True),
    ):
        if there:
            find = lambda setup, name=name: getattr(setup, name)
            make = _maker(find, lambda: jnp.zeros(3))
            found += _group(name, unit, find, scale, {"x": 0, "y": 1, "z": 2}, make)
    return found


def _group(group, unit, find, scale, indices, make=None, allowed=None) -> list[_Entry]:
    """A parameter for each index of an array, by the suffix of its name: {suffix: index}."""
    return [
        (
            group,
            Parameter(f"{group}_{suffix}", unit, find, index, make, scale=scale, allowed=allowed),
        )
        for suffix, index in indices.items()
    ]


def _numbered(count: int) -> dict[str, int]:
    return {str(i + 1): i for i in range(count)}


def _xy(count: int) -> dict[str, tuple[int, int]]:
    return {f"{i + 1}_{axis}": (i, j) for i in range(count) for j, axis in enumerate("xy")}


def parameters_of(scene: sr.Scene, names: Iterable[str]) -> tuple[AbstractParameter, ...]:
    """Those of these names, of which some may be paths of numbers in the scene.

    Raises `ValueError` for an unknown name, and for a path that leads to no number.
    """
    known, groups = catalogue(scene)

    def one(name: str) -> AbstractParameter:
        if is_path(name):
            return path_parameter(scene, name)
        if name not in known:
            listed = ", ".join([*known, *groups])
            close = get_close_matches(name, [*known, *groups], n=1)
            hint = f"did you mean {close[0]!r}? " if close else ""
            if name in NAMES:
                hint = "the scene has nothing of that kind; "
            raise ValueError(
                f"fit: unknown parameter {name!r}; {hint}known: {listed}; or a path of a number "
                "in the scene, such as segments[0].young_modulus"
            )
        return known[name]

    return tuple(map(one, names))


def choose(
    scene: sr.Scene, fit: Iterable[str] | str | None, given: Iterable[str] = ()
) -> tuple[str, ...]:
    """The names of the parameters to fit; those of `DEFAULT` that the scene has if None. Of a
    rubber young_modulus is that at small strain: all its constants, in their proportion.

    A name may be the path of a number in the scene (`calibration.parameters.paths`).

    A group is replaced by its members. Values of those in `given` come from recordings, so that
    the scene's own may be 0. Raises `ValueError` for an unknown name, a repeated one, none at all,
    and for a parameter that the scene does not have, or that is zero in it and is fitted as a
    factor, which has nothing to act on.
    """
    if fit is None:
        usual = zip(DEFAULT, parameters_of(scene, DEFAULT), strict=True)
        return tuple(name for name, p in usual if p.get(Setup(scene)) is not None)
    _, groups = catalogue(scene)
    asked = as_names(fit)
    if not asked:
        raise ValueError("fit: no parameters; name at least one, or leave it out for the default")
    if "gravity_tilt" in groups:
        # A turn about gravity itself changes nothing.
        along = "xyz"[int(np.argmax(np.abs(np.asarray(scene.gravity))))]
        groups["gravity_tilt"] = tuple(n for n in groups["gravity_tilt"] if n[-1] != along)
    names = tuple(n for name in asked for n in groups.get(name, (name,)))
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"fit: {name!r} is named twice; leave one out")
        if "young_modulus" in names and is_rubber(scene) and name.startswith("material"):
            raise ValueError(
                f"fit: young_modulus of a rubber is all its constants together, and {name!r} one "
                "of them; leave one out"
            )
        _check(scene, name, name in given)
    return names


def _check(scene: sr.Scene, name: str, may_be_zero: bool) -> None:
    (parameter,) = parameters_of(scene, [name])
    value = parameter.get(parameter.prepare(Setup(scene)))
    if value is None:
        raise ValueError(
            f"fit: the scene has no {name}; give it a starting value > 0 "
            f"({parameter.remedy} in the scene file), or leave it out of the fit"
        )
    if isinstance(parameter.scale, Factor) and not may_be_zero and not np.any(np.asarray(value)):
        raise ValueError(
            f"fit: {name} is 0 in the scene and is fitted as a factor of its initial value; "
            "give it a starting value > 0, or leave it out of the fit"
        )


def with_values(setup: Setup, names: tuple[str, ...], theta) -> Setup:
    """The setup with the parameters `names` at `theta`, (parameters,)."""
    return moved(setup, parameters_of(setup.scene, names), theta)


def moved(setup: Setup, parameters: tuple[AbstractParameter, ...], theta) -> Setup:
    """The setup with the parameters at `theta`, (parameters,)."""
    for parameter, coordinate in zip(parameters, theta, strict=True):
        value = parameter.scale.value(parameter.get(setup), coordinate)
        setup = parameter.put(setup, value)
    return setup


def prepared(scene: sr.Scene, names: Iterable[str]) -> Setup:
    """A setup around `scene` in which every one of `names` has a place."""
    setup = Setup(scene)
    for parameter in parameters_of(scene, names):
        setup = parameter.prepare(setup)
    return setup
