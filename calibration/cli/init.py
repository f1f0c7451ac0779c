"""Write a scene file to start from, commented: an own robot is one of these with its numbers.

robot      three tendons and an air chamber, hanging
finger     silicone and fibres, an air chamber beside the axis
tentacle   cast silicone that tapers, four tendons, a marker half way
needle     steel, bent at its tip, with a force on it
catheter   a stiff shaft and a soft bending section, one tendon
servos     two segments, six tendons that servos drive: their inputs are pulls
"""

from importlib import resources
from pathlib import Path

from calibration.cli.common import UsageError, check_writable

TEMPLATES = ("robot", "finger", "tentacle", "needle", "catheter", "servos")


def add_arguments(parser) -> None:
    parser.add_argument(
        "template",
        nargs="?",
        default="robot",
        metavar="TEMPLATE",
        choices=TEMPLATES,
        help=f"{', '.join(TEMPLATES)} (robot)",
    )
    parser.add_argument(
        "--out", metavar="FILE.toml", help="the scene file (default: TEMPLATE.toml here)"
    )
    parser.add_argument("--force", action="store_true", help="overwrite a file that is there")


def run(args) -> int:
    out = args.out if args.out is not None else f"{args.template}.toml"
    check_writable(out)
    if Path(out).exists() and not args.force:
        raise UsageError(f"--out {out}: is there already; give another name, or --force")
    text = resources.files("calibration.templates").joinpath(f"{args.template}.toml").read_text()
    Path(out).write_text(text, encoding="utf-8")
    print(f"{out} is written: exchange its numbers for those of your robot")
    print(f"with a recording: softrod import {out} LOG.csv")
    print(f"next: softrod plot {out}")
    return 0
