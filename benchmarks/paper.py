"""The article's robot again: Table 2, Figures 6 to 9, and what of its text agrees.

    python benchmarks/paper.py [--quick] [--write-docs]

M. Roshanfar et al., Actuators 2024, 13(1):8, doi:10.3390/act13010008. `TEXT` is quoted from it;
all else is computed by paper_study.py. Draws benchmarks/figures/paper_*.png. Some minutes on one
core; --quick: coarser batches, no loads at the tip.
"""

import sys
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import matplotlib
import numpy as np
import paper_figures
from paper_study import (
    ASSUMED,
    FULL,
    HIGHEST,
    PRINTED_E,
    QUICK,
    TABLE_1,
    TABLE_2,
    Size,
    Study,
    hysteresis,
    net,
    solid,
    study,
)
from report import machine, publish, table

import softrod_jax as sr

FIGURES = Path(__file__).parent / "figures"
GRAM_FORCE = 9.80665e-3  # N

TEXT = {  # the article's words; "moments" and "cap" hold formulas, "steps" is two rows of Table 1
    "fifteen": "a series of fifteen experiments",
    "range": "a tension range of 0 to 3 N for each tendon and an air pressure range of 0 to 40 kPa",
    "figure 6": "the impact of a 3 N tendon tension on each motor individually, while applying an "
    "internal chamber pressure of 10 kPa",
    "workspace": "the total working space of the tip of a soft robot that can be achieved through "
    "the simultaneous pulling of the three tendons",
    "motors": "To accurately estimate the tension of the tendons, the pulley’s diameter was "
    "incorporated in conjunction with the motor torque control capabilities",
    "pressure": "to investigate the influence of the chamber pressure and tendon tension on the "
    "deformation of a soft robot",
    "return": "the first tendon was released, causing the tip of the soft robot to return to its "
    "original position",
    "hysteresis": "the observed amount of hysteresis during the experiments had a negligible "
    "impact",
    "y small": "upon exerting tension along the x-axis, the Y displacement component approaches "
    "insignificance",
    "y opposed": "the Y displacement components exhibit a symmetrical opposition to one another",
    "angle": "separated by a fixed angle of 120",
    "moments": "For a circular rod, I_xx = I_yy = π r⁴ / 4",
    "cap": "The term P A_ch together represents the force amount generated due to the air pressure "
    "at the cap",
    "error": "a low relative Mean Absolute Error (MAE) in relation to the length of the robot",
    "length": "L denotes the length of the soft robot",
    "straight": "the rod was assumed to be straight",
    "stiffness": "a promising tool with adjustable stiffness",
    "contact": "maintaining the catheter-tissue contact force within a range of 10 to 30 grf",
    "steps": "Time increment 0.015 s, Coefficient of BDF-alpha method −0.2",
    "euler": "the forward Euler method for spatial integration",
}
GOOD, BAD, MUTE = "agrees", "**cannot**", "not to be checked"


class Claim(NamedTuple):
    text: str  # the article's
    ours: str
    verdict: str


def table_1_agrees() -> bool:
    """Whether `hybrid_robot` has the numbers of Table 1."""
    robot = sr.hybrid_robot()
    ours = {
        "Backbone radius": robot.section.radius,
        "Air chamber diameter": 2 * jnp.sqrt(robot.chambers.areas[0] / jnp.pi),
        "Tendons offset": jnp.linalg.norm(robot.tendons.offsets, axis=1),
        "Young's modulus": robot.young_modulus,
        "Density": robot.density,
        "Poisson's ratio": robot.poisson_ratio,
        "Viscous damping coefficients (bt)": robot.bending_damping,
        "Drag damping coefficient": robot.drag_coefficient,
    }
    return all(np.allclose(ours[name], TABLE_1[name], rtol=1e-12) for name in ours)


def claims(x: Study) -> list[Claim]:
    """The article's statements, ours beside them, and a verdict that follows from ours."""
    L, mega = ASSUMED["length"], 1e-6
    possible = lambda condition: GOOD if condition else BAD
    agrees = lambda condition: GOOD if condition else "**does not agree**"
    reach = lambda rest: int(np.sum(rest.result[..., -1] == 0))
    E = f"E = {x.stated_E * mega:.2f} MPa"
    all_three = x.moduli[3, "solid"]
    area, moment = (1 - b / a for a, b in zip(solid(), net(), strict=True))
    tips = x.stated.tip  # (tendons, pressures, levels, 3)
    turn = lambda angle: np.array(
        [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
    )
    skew = max(np.abs(tips[0] @ turn(2 * np.pi * i / 3).T - tips[i]).max() for i in (1, 2))
    rest = x.tips[:, np.searchsorted(x.ts, ASSUMED["pause"])]
    back = np.linalg.norm(x.tips[:, -1] - rest, axis=-1).max()
    loop = hysteresis(x.ts, x.tips)
    stretch = x.stated.strains[0, :, 0, 0, 2] - 1
    force = stretch * x.stated_E * solid()[0]
    cap = TABLE_2["P"] * np.pi * TABLE_1["Air chamber diameter"] ** 2 / 4
    figure_6 = x.stated.tip[:, 1, -1] * 1e3
    apart = np.linalg.norm(tips[0, -1, -1] - tips[0, 0, -1])
    rows = [
        Claim("Table 1", "`hybrid_robot` has its numbers", agrees(table_1_agrees())),
        Claim(
            _quote("moments"),
            f"the same; chamber and passages would take {area:.0%} of A and {moment:.1%} of I",
            agrees(np.isclose(sr.Circle(TABLE_1["Backbone radius"]).second_moments[0], solid()[1])),
        ),
        Claim(_quote("length"), f"no number is given; {L:g} m is assumed", MUTE),
        Claim(
            _quote("range"),
            f"E = 0.05 MPa ends at {x.limits[0]:.2f} N (no pressure) to {x.limits[-1]:.2f} N "
            f"(40 kPa) of one tendon",
            possible(x.limits.min() >= HIGHEST),
        ),
        Claim(
            _quote("fifteen"),
            f"E = 0.05 MPa: {reach(x.printed)} of 15 have an equilibrium at 3 N; from "
            f"{x.moduli[1, 'solid'] * mega:.4f} MPa all ({x.moduli[1, 'net'] * mega:.4f} with the "
            f"holes); {E}: {reach(x.stated)}",
            possible(reach(x.printed) == 15),
        ),
        Claim(
            _quote("workspace"),
            f"E = 0.05 MPa: {x.cube_share:.0%} of all tensions to 3 N have an equilibrium; from "
            f"{all_three * mega:.4f} MPa all ({x.moduli[3, 'net'] * mega:.4f} with the holes)",
            possible(x.cube_share == 1),
        ),
        Claim(
            _quote("figure 6"),
            f"E = 0.05 MPa: no equilibrium; {E}: tips at "
            + ", ".join(f"({a:.0f}, {b + 0.0:.0f}, {c:.0f})" for a, b, c in figure_6)
            + " mm",
            possible(np.all(x.printed.result[:, 1, -1] == 0)),
        ),
        Claim(
            _quote("motors"),
            f"if {PRINTED_E / x.stated_E:.1%} of it reaches the robot, 0.05 MPa has the tips of "
            f"{E}, within {x.weak_gaps[0] * 1e3:.1g} mm without pressure and "
            f"{x.weak_gaps[-1] * 1e3:.1g} mm at 40 kPa",
            MUTE,
        ),
        Claim(
            _quote("y small"),
            f"{E}: at most {np.abs(tips[0, ..., 1]).max() * 1e3:.0e} mm",
            agrees(np.abs(tips[0, ..., 1]).max() < 1e-9),
        ),
        Claim(
            _quote("y opposed"),
            f"{E}: the sum of both is at most {np.abs(tips[1:, ..., 1].sum(0)).max() * 1e3:.0e} mm",
            agrees(np.abs(tips[1:, ..., 1].sum(0)).max() < 1e-9),
        ),
        Claim(
            _quote("angle"),
            f"{E}: tips, turned by 120°, differ by {skew * 1e3:.0e} mm",
            agrees(skew < 1e-9),
        ),
        Claim(
            _quote("return"),
            f"{E}: after three pulls, back within {back * 1e3:.1g} mm",
            agrees(back < 1e-2 * L),
        ),
        Claim(
            _quote("hysteresis"),
            f"{E}: up and down differ by at most {loop / L:.1%} of L, if a pull rises and falls "
            f"within {ASSUMED['pull']:g} s each (no time is given)",
            agrees(loop < 1e-2 * L),
        ),
        Claim(
            _quote("cap"),
            f"stretch times EA is {force[-1]:.3f} N at 40 kPa, P A_ch {cap[-1]:.3f} N",
            agrees(np.allclose(force, cap, atol=1e-9)),
        ),
        Claim(
            _quote("pressure"),
            f"{E}: from 0 to 40 kPa the tip at 3 N moves {apart / L:.1%} of L; the free robot "
            f"lengthens by {stretch[-1]:.1%} "
            f"({cap[-1] / (PRINTED_E * solid()[0]):.1%} at 0.05 MPa)",
            MUTE,
        ),
        Claim(_quote("error"), "neither a number nor the measured positions are in the text", MUTE),
    ]
    return rows + (_load_claims(x, E) if x.loads else [])


def _load_claims(x: Study, E) -> list[Claim]:
    loads, L = x.loads, ASSUMED["length"]
    change, soft = (k[-1] / k[0] - 1 for k in (loads["stiffness"], loads["printed stiffness"]))
    short = {modulus: 1e3 * length for modulus, length in loads["upright length"].items()}
    low, high = 10 * GRAM_FORCE, 30 * GRAM_FORCE
    return [
        Claim(
            _quote("straight"),
            f"hanging, always; upright up to L = {short[PRINTED_E]:.0f} mm at 0.05 MPa, "
            f"{short[x.stated_E]:.0f} mm at {E}; gravity's direction is not given, and would move "
            f"the tip at 3 N by {loads['hanging'] * 1e3:.0f} (hanging) or "
            f"{loads['upright'] * 1e3:.0f} mm (upright)",
            MUTE,
        ),
        Claim(
            _quote("stiffness"),
            f"across the tip, from 0 to 40 kPa: {change:+.1%} ({soft:+.1%} at 0.05 MPa): linear "
            f"elasticity does not stiffen",
            "agrees" if change > 0.05 else "**does not agree**",
        ),
        Claim(
            _quote("contact"),
            f"{E}: {loads['blocked'] / GRAM_FORCE:.0f} grf hold the tip on the axis against 3 N "
            f"(the article does not claim it)",
            "within" if low <= loads["blocked"] <= high else "outside",
        ),
        Claim(
            _quote("steps"),
            f"{E}: tips of the fifteen motions within {x.step_error / L:.2%} of L of order 4",
            "agrees" if x.step_error < 1e-2 * L else "**does not agree**",
        ),
        Claim(_quote("euler"), "the number of its steps is not given", MUTE),
    ]


def _quote(name) -> str:
    return f"“{TEXT[name]}”"


def main(size: Size = FULL, directory: Path = FIGURES) -> tuple[Study, list[Claim]]:
    x = study(size)
    rows = claims(x)
    directory.mkdir(exist_ok=True)
    paper_figures.draw(x, directory)
    body = table(["the article", "here", ""], [list(row) for row in rows])
    publish("paper", "article.md", f"{body}\n\n{machine()}.")
    return x, rows


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    matplotlib.use("agg")
    main(QUICK if "--quick" in sys.argv[1:] else FULL)
