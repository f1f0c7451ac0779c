"""The scenes of `work_precision.py`: what moves, what solves it, and what is compared with."""

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path

import diffrax
import jax.numpy as jnp
import numpy as np

import softrod_jax as sr

# Independent solutions, where they lie beside the repository.
REFERENCE = Path(__file__).parents[2] / "shared" / "reference"

ACROSS, HANGING = np.array([-9.81, 0.0, 0.0]), np.array([0.0, 0.0, 9.81])  # m/s^2


def scheme_name(scheme: sr.BDFAlpha | sr.SDIRK) -> str:
    """As Python, without what is the default."""
    match scheme:
        case sr.BDFAlpha(alpha=alpha):
            return f"BDFAlpha({alpha:g})"
        case sr.SDIRK(order=order, stages=stages):
            usual = stages == sr.SDIRK(order).stages
            return f"SDIRK({order})" if usual else f"SDIRK({order}, stages={stages})"


@dataclasses.dataclass(frozen=True)
class Setting:
    """A method along the rod and, for motions, a scheme and a time step [ms]."""

    method: sr.Collocation | sr.Shooting
    scheme: sr.BDFAlpha | sr.SDIRK | None = None
    step: float | None = None
    newton: sr.NewtonOptions = sr.NewtonOptions()

    @property
    def family(self) -> str:
        """Settings of one family differ in how fine they are, and make one line in the figure."""
        match self.method:
            case sr.Collocation(order=order):
                along = f"order {order}"
            case sr.Shooting(solver=solver, segments=segments):
                kind = "single shooting" if segments == 1 else "shooting"
                along = f"{kind}, {type(solver).__name__}"
        loose = ", loose Newton" if self.newton.tolerance > 1e-10 else ""
        if self.scheme is None:
            return f"{along}{loose}"
        return f"{scheme_name(self.scheme)}, {along}{loose}"

    @property
    def name(self) -> str:
        """The setting as Python, and its step."""
        match self.method:
            case sr.Collocation(intervals=intervals, order=order):
                parts = [f"`Collocation({intervals}, order={order})`"]
            case sr.Shooting(segments=segments, steps=steps, solver=solver):
                parts = [f"`Shooting({segments}, {steps}, {type(solver).__name__}())`"]
        if self.scheme is not None:
            parts = [f"`{scheme_name(self.scheme)}`, {self.step:.3g} ms", *parts]
        if self.newton.tolerance > 1e-10:
            parts.append(f"Newton to {self.newton.tolerance:.0e}".replace("e-0", "e-"))
        return ", ".join(parts)


@dataclasses.dataclass(frozen=True)
class Case:
    """A scene and its loads.

    - `inputs`: tensions and pressures at times [s], (steps, actuators) each; None: absent.
    - `duration` [s]: None for an equilibrium. The tip is compared every `sample` [ms].
    - `fine`: refined solutions, of different methods; the distance of the two says how well the
      first is known. `reference`: the name of an independent motion, used where it is there.
    - `levels`: errors [m] at which the table names the fastest setting.
    """

    title: str
    scene: sr.Scene
    inputs: Callable
    settings: list[Setting]
    fine: tuple[Setting, Setting]
    levels: tuple[float, ...]
    duration: float | None = None
    sample: float = 40.0
    reference: str | None = None
    drawn: bool = True

    def independent(self):
        """The tip's path and how well it is known [m], or None where the folder is absent."""
        file = REFERENCE / "dynamic.json"
        if self.reference is None or not file.exists():
            return None
        path = json.loads(file.read_text())["cases"][self.reference]["trajectory"]
        tip = np.stack([path["x"], np.zeros(len(path["x"])), path["z"]], axis=1)
        every = round(self.sample / (1e3 * path["t"][1]))
        return tip[::every], path["max_change_from_previous_level"]


def bare(gravity=None, tendons=False):
    """The paper's robot without drag and chamber, as the independent motions have it."""
    robot = sr.hybrid_robot(gravity=gravity)
    absent = dict(drag_coefficient=None, chambers=None)
    return dataclasses.replace(robot, tendons=robot.tendons if tendons else None, **absent)


def steel_rod():
    """A wire of 0.5 m, 1.4 mm thick."""
    radius, young = 0.7e-3, 2e11
    bending = young * np.pi * radius**4 / 4
    return sr.Scene(
        length=0.5,
        section=sr.Circle(radius),
        young_modulus=young,
        poisson_ratio=0.3,
        density=7850.0,
        bending_damping=2e-4 * bending,
        gravity=ACROSS,
    )


def everything():
    """All that a scene may have, on the robot hanging."""
    return dataclasses.replace(
        sr.hybrid_robot(gravity=HANGING),
        shear_damping=1e-3,
        payload=sr.Payload(2e-3),
        tip_load=sr.TipLoad(force=jnp.array([0.0, 5e-3, 0.0])),
    )


def ramp(t, duration):
    """From 0 to 1, with two continuous derivatives."""
    x = np.minimum(t / duration, 1.0)
    return (x**3 * (10 - 15 * x + 6 * x**2))[:, None]


def _grid(scheme, *pairs, order=6, **options):
    """Settings of one scheme: pairs of a step [ms] and a number of intervals."""
    return [
        Setting(sr.Collocation(intervals, order=order), scheme, step, **options)
        for step, intervals in pairs
    ]


def _shooting(scheme, *triples, solver=None):
    solver = solver or diffrax.Tsit5()
    return [
        Setting(sr.Shooting(segments, steps, solver), scheme, step)
        for step, segments, steps in triples
    ]


_LOOSE = sr.NewtonOptions(tolerance=1e-6)
_THIRD = 40 / 3


def _static():
    shooting = [
        Setting(sr.Shooting(segments, steps, solver))
        for solver, segments, counts in (
            (diffrax.Heun(), 5, (4, 16)),
            (diffrax.Bosh3(), 5, (4, 16)),
            (diffrax.Tsit5(), 5, (1, 2, 4, 8)),
            (diffrax.Dopri8(), 5, (1, 2)),
            (diffrax.Tsit5(), 1, (10, 20, 40)),
        )
        for steps in counts
    ]
    collocation = [
        Setting(sr.Collocation(intervals, order=order))
        for order, counts in ((4, (4, 8, 16, 32)), (6, (3, 4, 6, 8, 12, 16)))
        for intervals in counts
    ]
    return Case(
        title="Equilibrium: two tendons, hanging",
        scene=bare(HANGING, tendons=True),
        inputs=lambda t: (jnp.array([0.2, 0.05, 0.0]), None),
        settings=collocation + shooting,
        fine=(Setting(sr.Shooting(10, 20, diffrax.Dopri8())), Setting(sr.Collocation(48))),
        levels=(1e-5, 1e-8),
    )


def _gravity():
    SDIRK, BDF = sr.SDIRK, sr.BDFAlpha
    return Case(
        title="Gravity acts, 1 s",
        scene=bare(ACROSS),
        inputs=lambda t: (None, None),
        settings=[
            *_grid(SDIRK(4), (20, 3), (20, 4), (_THIRD, 5), (_THIRD, 6), (10, 6), (5, 8), (4, 10)),
            *_grid(SDIRK(4), (40 / 12, 12), (2, 14)),
            *_grid(SDIRK(4), (_THIRD, 6), (10, 6), (4, 10), newton=_LOOSE),
            *_grid(SDIRK(4), (20, 8), (10, 12), (5, 24), order=4),
            *_grid(SDIRK(3), (20, 3), (20, 4), (_THIRD, 5), (_THIRD, 6), (10, 6), (5, 8), (4, 10)),
            *_grid(SDIRK(3), (2.5, 12), (2, 14)),
            *_grid(SDIRK(3), (20, 3), (20, 4), (_THIRD, 5), (_THIRD, 6), (10, 6), newton=_LOOSE),
            *_grid(SDIRK(3), (5, 8), (4, 10), newton=_LOOSE),
            *_grid(SDIRK(3, stages=6), (40, 3), (20, 5), (_THIRD, 6), (10, 8)),
            *_grid(SDIRK(3, stages=6), (40, 3), (20, 5), (_THIRD, 6), (10, 8), newton=_LOOSE),
            *_grid(SDIRK(2), (40, 3), (20, 3), (10, 4), (5, 5), (2.5, 6)),
            *_grid(BDF(-0.45), (20, 3), (10, 3), (5, 4), (2, 6), (1, 8)),
            *_grid(BDF(-0.2), (10, 3), (5, 4), (2, 6), (1, 8)),
            *_grid(BDF(0.0), (10, 3), (5, 4), (2, 6)),
            *_shooting(SDIRK(3), (40, 5, 4), (20, 10, 4), (10, 10, 6)),
        ],
        fine=_grid(SDIRK(4), (1, 24)) + _grid(SDIRK(3), (1, 40), order=4),
        levels=(1e-3, 1e-4, 1e-5, 1e-6),
        duration=1.0,
        reference="gravity_step",
    )


def _ramp():
    def inputs(t):
        return ramp(t, 0.05) * np.array([0.3, 0.0, 0.0]), None

    return Case(
        title="A tendon pulls: 0.3 N in 50 ms, 1 s",
        scene=bare(tendons=True),
        inputs=inputs,
        settings=[
            *_grid(sr.SDIRK(3), (20, 4), (10, 6), (5, 8), (2, 12), (1, 16)),
            *_grid(sr.SDIRK(4), (10, 6), (5, 8), (2, 12)),
            *_grid(sr.SDIRK(2), (10, 4), (5, 6), (2, 8)),
            *_grid(sr.BDFAlpha(-0.45), (10, 4), (5, 6), (2, 8), (1, 12), (0.5, 16)),
            *_grid(sr.BDFAlpha(-0.2), (5, 6), (2, 8), (1, 12)),
            *_grid(sr.BDFAlpha(-0.45), (2, 16), (1, 24), order=4),
        ],
        fine=_grid(sr.BDFAlpha(-0.45), (0.25, 24)) + _grid(sr.SDIRK(4), (0.5, 40), order=4),
        levels=(1e-3, 1e-4),
        duration=1.0,
        reference="tendon_ramp_0.3N_50ms",
    )


def _steel():
    return Case(
        title="A steel wire falls, 0.4 s",
        scene=steel_rod(),
        inputs=lambda t: (None, None),
        settings=[
            *_grid(sr.SDIRK(3), (20, 3), (10, 4), (5, 4), (2.5, 6), (1, 8)),
            *_grid(sr.SDIRK(4), (20, 3), (10, 4), (5, 4), (2.5, 6), (1, 8)),
            *_grid(sr.SDIRK(4), (5, 8), (2.5, 12), order=4),
            *_grid(sr.SDIRK(2), (10, 4), (5, 4), (2, 6)),
            *_grid(sr.BDFAlpha(-0.45), (10, 4), (5, 4), (2, 6), (1, 8)),
            *_grid(sr.BDFAlpha(-0.2), (5, 4), (2, 6), (1, 8)),
            *_shooting(sr.SDIRK(3), (20, 5, 4), (10, 10, 4)),
        ],
        fine=_grid(sr.SDIRK(4), (0.5, 16)) + _grid(sr.SDIRK(3), (0.25, 24), order=4),
        levels=(1e-3, 1e-5),
        duration=0.4,
        sample=20.0,
    )


def _everything():
    def inputs(t):
        rise = ramp(t, 0.1)
        return rise * np.array([0.15, 0.05, 0.02]), rise * np.array([2e4])

    return Case(
        title="Everything on, 0.4 s",
        scene=everything(),
        inputs=inputs,
        settings=[
            *_grid(sr.SDIRK(4), (20, 4), (10, 6), (5, 8), (2, 12)),
            *_grid(sr.SDIRK(3), (20, 4), (10, 6), (5, 8), (2, 12)),
            *_grid(sr.BDFAlpha(-0.45), (10, 4), (5, 6), (2, 8), (1, 12)),
            *_grid(sr.BDFAlpha(-0.2), (5, 6), (2, 8)),
            *_shooting(sr.SDIRK(3), (20, 10, 4)),
        ],
        fine=_grid(sr.SDIRK(4), (0.5, 20)) + _grid(sr.BDFAlpha(-0.45), (0.2, 40), order=4),
        levels=(1e-3, 1e-5),
        duration=0.4,
        sample=20.0,
    )


def _tendon():
    return Case(
        title="Equilibrium: a tendon pulls, nothing else",
        scene=bare(tendons=True),
        inputs=lambda t: (jnp.array([0.1, 0.0, 0.0]), None),
        settings=[
            *(Setting(sr.Collocation(intervals)) for intervals in (1, 2, 4, 12)),
            Setting(sr.Collocation(4, order=4)),
            Setting(sr.Shooting(1, 5)),
        ],
        fine=(Setting(sr.Shooting(10, 20, diffrax.Dopri8())), Setting(sr.Collocation(48))),
        levels=(1e-8,),
        drawn=False,
    )


CASES = {
    "tendon": _tendon,
    "static": _static,
    "gravity": _gravity,
    "ramp": _ramp,
    "steel": _steel,
    "everything": _everything,
}
