"""The options of `softrod calibrate`."""

import argparse

from calibration.cli.common import add_mapping, number, positive
from calibration.parameters.names import LAWS, NAMES, USUAL

_DEFAULT_OUT = "softrod-calibration"
EPILOG = (
    "what can be fitted, of what the scene has, by name:\n"
    + "\n".join(f"  {name:24}{words}" for name, words in NAMES.items())
    + (
        "\nand any number of the scene by its path in the file, such as segments[1].young_modulus "
        "or tendons[*].friction"
    )
)


def _count(text: str) -> int:
    """A whole number from 1, for argparse."""
    value = number(text)
    if value < 1 or value != int(value):
        raise argparse.ArgumentTypeError(f"{text} is not a whole number from 1")
    return int(value)


def add_arguments(parser) -> None:
    """All options of `softrod calibrate`."""
    _add_what(parser)
    _add_postures(parser.add_argument_group("postures instead of motions"))
    _add_comparison(parser.add_argument_group("several models"))
    _add_search(parser.add_argument_group("search and checks"))
    _add_data(parser.add_argument_group("data"))
    _add_c3d(parser.add_argument_group("C3D files without a mapping"))


def _add_what(parser) -> None:
    """What is fitted to what, and where the results go."""
    parser.add_argument("scene", nargs="?", metavar="SCENE.toml", help="the scene file")
    parser.add_argument(
        "logs", nargs="*", metavar="LOG", help="recordings, or patterns such as 'run_*.csv'"
    )
    parser.add_argument(
        "--fit",
        metavar="NAME,..",
        help="parameters to fit, see below (default: those of young_modulus, bending_damping and "
        "drag_coefficient that the scene has; of a rubber young_modulus is that at small strain, "
        "all its constants in the proportion that they have in the file)",
    )
    parser.add_argument(
        "--per-recording",
        metavar="NAME,..",
        help="those of them of which each recording has its own value",
    )
    parser.add_argument(
        "--bounds",
        metavar="NAME=LOW:HIGH",
        nargs="+",
        help="bounds of parameters, in their units",
    )
    parser.add_argument(
        "--no-time-offset",
        action="store_true",
        help="trust the recordings' clocks: do not fit when inputs or release really began",
    )
    parser.add_argument(
        "--held-out", metavar="LOG", nargs="+", help="recordings to predict and not to fit"
    )
    parser.add_argument(
        "--prior",
        metavar="NAME=MEAN:SPREAD",
        nargs="+",
        help="what is known beforehand, mean and standard deviation, such as density=1070:20",
    )
    parser.add_argument(
        "--priors-from",
        metavar="DIR",
        help="what another fit found, such as one to postures, of what is fitted here, as priors",
    )
    parser.add_argument(
        "--out",
        default=_DEFAULT_OUT,
        metavar="DIR",
        help=f"where the results go (default: {_DEFAULT_OUT})",
    )
    parser.add_argument("--json", action="store_true", help="parameters.json on stdout as well")
    parser.add_argument(
        "--resume", action="store_true", help="go on with an interrupted fit in DIR"
    )


def _add_postures(postures) -> None:
    """Equilibria instead of motions."""
    postures.add_argument(
        "--postures",
        metavar="LOG",
        nargs="*",
        help="logs of which each row is an equilibrium, not a moment of a motion",
    )
    postures.add_argument(
        "--with-postures",
        metavar="LOG",
        nargs="+",
        help="such logs, fitted together with the motions, to the parameters that all share",
    )
    postures.add_argument(
        "--folds",
        type=_count,
        metavar="N",
        help="keep trials aside in N parts, one after the other, and predict them",
    )
    postures.add_argument(
        "--posterior",
        choices=("laplace", "nuts"),
        help="draws of the posterior, by Laplace's approximation or by NUTS",
    )
    postures.add_argument(
        "--draws", type=_count, metavar="N", help="with --posterior: how many draws (1000)"
    )


def _add_comparison(comparison) -> None:
    """Models that are compared."""
    laws = ", ".join(LAWS)
    comparison.add_argument(
        "--compare",
        metavar="MODEL",
        nargs="*",
        help="fit several models, tell which the data ask for, and report that one. A MODEL is a "
        f"law of damping, out of {laws} (with none named, {', '.join(USUAL)}); NAME,.. to fit "
        "instead of --fit; +NAME,.. to fit besides; or another scene, OTHER.toml or "
        "OTHER.toml:NAME,.. What --fit names is one of them, unless only laws or scenes are given",
    )


def _add_search(search) -> None:
    """How it is searched, and how finely it is simulated."""
    search.add_argument(
        "--optimiser",
        help="levenberg_marquardt, or adam (gradient descent), which is usual for many parameters",
    )
    search.add_argument(
        "--loss", default="squares", help="squares, or huber or tukey, which outliers hardly move"
    )
    search.add_argument(
        "--starts", type=_count, default=1, metavar="N", help="search from N places (1)"
    )
    search.add_argument(
        "--profile", metavar="NAME,..", help="parameters of which to make the profile likelihood"
    )
    search.add_argument(
        "--explain", action="store_true", help="tell what else would explain the residuals"
    )
    search.add_argument(
        "--material", metavar="NAME", help="compare values with this material's range"
    )
    search.add_argument(
        "--no-checks",
        action="store_true",
        help="do not simulate the result again with half the step and twice the grid",
    )
    search.add_argument(
        "--dt",
        type=positive,
        metavar="S",
        help="time step [s] (default: found by simulating the recordings with finer ones)",
    )
    search.add_argument(
        "--intervals",
        type=_count,
        metavar="N",
        help="intervals along the rod (default: found in the same way)",
    )
    search.add_argument(
        "--tolerance",
        type=positive,
        metavar="PART",
        help="how far the simulated tip may be off by the time step, in lengths of the rod, and by "
        "the intervals, a tenth of that (1e-3)",
    )


def _add_data(data) -> None:
    """How the recordings are read, and what of them is used."""
    add_mapping(data)
    data.add_argument(
        "--condition",
        metavar="NAME=V1,V2,..",
        nargs="+",
        help="in what the recordings differ from the scene, such as payload_mass=0,0.052: a value "
        "for each recording, then for each of --held-out, or one for all",
    )
    data.add_argument(
        "--one-frame",
        action="store_true",
        help="recordings that do not know where the clamp is were made with one set-up: fit one "
        "frame to all, not another to each",
    )
    data.add_argument(
        "--look", action="store_true", help="plot the recordings to DIR/data.png, and stop there"
    )
    data.add_argument(
        "--window",
        type=number,
        nargs=2,
        metavar=("START", "END"),
        help="use this part of each recording only [s, on its own clock]",
    )
    data.add_argument(
        "--split",
        type=positive,
        nargs=2,
        metavar=("DURATION", "LEAD"),
        help="cut logs with inputs into windows [s], each with a lead to forget its beginning",
    )
    data.add_argument(
        "--drift",
        metavar="WHAT=DURATION",
        nargs="+",
        help="what may drift in long logs with inputs, of clock, tip and inputs, and the duration "
        "of the windows [s] in each of which it changes linearly, such as tip=2 inputs=5",
    )


def _add_c3d(c3d) -> None:
    """How the markers of a motion capture are told apart."""
    c3d.add_argument(
        "--tip-markers", metavar="LABEL,..", help="how the tip markers' labels begin (tip)"
    )
    c3d.add_argument(
        "--base-markers",
        metavar="LABEL,..",
        help="how the clamp markers' labels begin (base); none: do not use them",
    )
    c3d.add_argument(
        "--tip-body",
        action="store_true",
        help="the tip markers, three or more, are on one body: its pose is measured, place and "
        "attitude",
    )
    c3d.add_argument(
        "--axes",
        metavar="AXES",
        help="which axes of the file are the scene's x, y, z (x,y,z); with a leading minus, "
        "write --axes=-y,x,z",
    )
