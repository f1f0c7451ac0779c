"""What the commands share: setting JAX up, numbers, actuation and JSON."""

import argparse
import json
import math
import os
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

# More are a typing error.
_MOST_INTERVALS = 10_000


class UsageError(ValueError):
    """A command line that cannot be: the message names the option, its value and the remedy."""


def prepare_jax() -> None:
    """float64, and compiled programs kept on disk between runs.

    The cache lies in JAX_COMPILATION_CACHE_DIR if set, else in the user's cache directory. A
    directory that cannot be written means no cache and is no error.
    """
    import jax

    jax.config.update("jax_enable_x64", True)
    directory = cache_directory()
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError:
        return
    if not os.access(directory, os.W_OK):
        return
    jax.config.update("jax_compilation_cache_dir", str(directory))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)


def cache_directory() -> Path:
    """Where compiled programs are kept."""
    chosen = os.environ.get("JAX_COMPILATION_CACHE_DIR")
    if chosen:
        return Path(chosen)
    user = os.environ.get("XDG_CACHE_HOME") or os.path.join("~", ".cache")
    return Path(os.path.expanduser(user)) / "softrod_jax"


def number(text: str) -> float:
    """A finite number, for argparse."""
    try:
        # Python would read 1_0 as 10.
        value = float(text) if "_" not in text and text.isascii() else math.nan
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text!r} is not a finite number")
    return value


def positive(text: str) -> float:
    """A number above 0, for argparse."""
    value = number(text)
    if value <= 0:
        raise argparse.ArgumentTypeError(f"{text} is not above 0")
    return value


def part_of_length(text: str) -> float:
    """A number between 0 and 1, for argparse."""
    value = positive(text)
    if value >= 1:
        raise argparse.ArgumentTypeError(f"{text}: a part of the rod's length, below 1")
    return value


def intervals(text: str) -> int:
    """How many intervals along the rod, for argparse."""
    value = number(text)
    if value != int(value) or not 1 <= value <= _MOST_INTERVALS:
        raise argparse.ArgumentTypeError(f"{text}: a whole number from 1 to {_MOST_INTERVALS}")
    return int(value)


def add_grid(parser, tolerance: str) -> None:
    """The options --intervals and --tolerance, of which the latter does `tolerance`."""
    parser.add_argument(
        "--intervals",
        type=intervals,
        metavar="N",
        help="of the grid along the rod, each of order 6",
    )
    parser.add_argument("--tolerance", type=part_of_length, metavar="X", help=tolerance)


def grid(args) -> dict:
    """What --intervals and --tolerance say, for `solve_static` and `simulate`."""
    import softrod_jax as sr

    options = {}
    if args.intervals is not None:
        options["method"] = sr.Collocation(args.intervals)
    if args.tolerance is not None:
        options["tolerance"] = args.tolerance
    return options


def reason(code, moving: bool = False) -> str:
    """The message of a result code, with the remedies that a command line has."""
    from softrod_jax import RESULTS, result_message

    finer = "give more --intervals, or a --tolerance"
    slower = "give a smaller --dt, or smaller loads"
    remedies = {
        RESULTS.diverged: slower if moving else f"give smaller loads, or else {finer[5:]}",
        RESULTS.max_iterations: slower if moving else f"give smaller loads, or else {finer[5:]}",
        RESULTS.inaccurate: (
            f"{finer} (a larger one, if there is one), or a smaller --dt"
            if moving
            else f"{finer} (a larger one, if there is one)"
        ),
    }
    return result_message(code, remedies.get(RESULTS(int(code))))


def add_actuation(parser: argparse.ArgumentParser) -> None:
    """The options --tension, --pressure and --pull."""
    helps = {
        "tension": "tension of each tendon [N], at least 0; without it the tendons are slack",
        "pressure": "gauge pressure of each chamber [Pa]; without it there is none",
        "pull": "by how much each tendon that is driven by its length is shortened [m]; 0 without",
    }
    for name, letter in zip(helps, "TPD", strict=True):
        parser.add_argument(f"--{name}", type=number, nargs="+", metavar=letter, help=helps[name])


def add_mapping(parser) -> None:
    """The option --mapping, of what reads logs."""
    parser.add_argument(
        "--mapping",
        metavar="FILE.toml",
        help="which columns of the log are what (default: LOG.map.toml beside LOG, if it is "
        "there); `softrod import LOG` writes it",
    )


def given_inputs(args) -> list[str]:
    """Those of the options of `add_actuation` that are on the command line."""
    from softrod_jax.scene.inputs import KINDS

    return [f"--{kind.one}" for kind in KINDS if getattr(args, kind.one) is not None]


def actuation(args, scene) -> Any:
    """The `Inputs` of the command line as arrays (n,), None where not given. Tendons that are
    driven by their length are there at pull 0, too.

    Raises `UsageError` unless there is one for each actuator, and for negative tensions.
    """
    import numpy as np

    from softrod_jax.scene.inputs import KINDS, Inputs

    found = {}
    for kind in KINDS:
        values, count = getattr(args, kind.one), kind.count(scene)
        if values is not None:
            found[kind.name] = _one_each(kind, values, count, scene)
        elif kind.control == "length" and count:
            found[kind.name] = np.zeros(count)
    return Inputs(**found)


def _one_each(kind, values, count, scene):
    import numpy as np

    option, of = f"--{kind.one}", kind.of(scene)
    one = of.replace(kind.part, kind.part.removesuffix("s"))
    if not count:
        add = f"[[{kind.part}]] to the file"
        add += f' with control = "{kind.control}"' if of != kind.part else ""
        raise UsageError(f"{option}: the scene has no {of}; leave it out, or add {add}")
    if len(values) != count:
        raise UsageError(
            f"{option}: {len(values)} given, and the scene has {count} "
            f"{one if count == 1 else of}; give one number per {one}"
        )
    if min(values) < kind.at_least:
        raise UsageError(
            f"{option} {' '.join(f'{x:g}' for x in values)}: {kind.reason}; every {kind.one} is at "
            f"least {kind.at_least:g}"
        )
    return np.array(values)


def check_writable(path: str, option: str = "--out") -> None:
    """Raise `UsageError` if a file `path` cannot be written, before hours of computing."""
    if "\0" in path or not path:
        raise UsageError(f"{option} {path!r}: is not the name of a file")
    target = Path(path)
    if target.is_dir():
        raise UsageError(f"{option} {path}: is a directory; give the name of a file")
    if not target.parent.is_dir():
        raise UsageError(f"{option} {path}: the directory {target.parent} does not exist")
    if not os.access(target if target.exists() else target.parent, os.W_OK):
        raise UsageError(f"{option} {path}: no permission to write there")


def check_posterior_options(args) -> None:
    """Raises `UsageError` for draws of no posterior, and for NUTS without its package."""
    if args.draws is not None and args.posterior is None:
        raise UsageError("--draws: of --posterior, which is not there; give it, or leave it out")
    if args.posterior == "nuts" and find_spec("blackjax") is None:
        raise UsageError("--posterior nuts: needs blackjax: pip install 'softrod_jax[posterior]'")


def note(message: str) -> None:
    """Something that the user should know, on stderr."""
    print(f"softrod: note: {message}", file=sys.stderr)


def note_self_contact(scene, found, known: int | None = None) -> None:
    """A note where the rod passes through itself, in a solution or a motion known so far."""
    import jax
    import numpy as np

    import softrod_jax as sr

    # Parts of a rod that turns by less than a quarter are apart, and nothing is compiled to see it.
    bend = np.linalg.norm(np.asarray(found.strains)[..., 3:], axis=-1)
    turn = np.sum((bend[..., 1:] + bend[..., :-1]) / 2 * np.diff(found.arc_lengths), axis=-1)
    if not np.any(np.atleast_1d(turn)[:known] > 1.5):
        return
    gaps = np.atleast_1d(jax.jit(sr.self_distance)(scene, found))[:known]
    if len(gaps) and (least := np.min(gaps)) < 0:
        note(
            f"the rod passes through itself, {-1e3 * least:.3g} mm deep: no force keeps its parts "
            "apart, and this is no state that a rod can be in"
        )


def print_json(content: dict) -> None:
    """`content` on stdout; numbers that are not finite become null, which JSON can carry."""
    print(json.dumps(_finite(content)))


def _finite(value):
    if isinstance(value, dict):
        return {k: _finite(v) for k, v in value.items()}
    if isinstance(value, list):
        return [_finite(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def names_in(text: str | None) -> tuple[str, ...]:
    """Names that are separated by commas."""
    return () if text is None else tuple(x.strip() for x in text.split(","))


def pair_in(option: str, text: str, form: str) -> tuple[str, tuple[float, float]]:
    """NAME=A:B; `form` says what they are, with an example."""
    name, _, numbers = text.rpartition("=")
    try:
        first, second = (float(x) for x in numbers.split(":"))
    except ValueError:
        raise UsageError(f"--{option} {text}: expected {form}") from None
    return name.strip(), (first, second)


def bound_in(text: str) -> tuple[str, tuple[float, float]]:
    """NAME=LOW:HIGH."""
    return pair_in("bounds", text, "NAME=LOW:HIGH, such as young_modulus=1e5:1e6")


def priors_of(directory: str | None) -> dict[str, tuple[float, float]]:
    """What another fit found, as priors: of each parameter that it identified the value and a
    quarter of the interval's width.

    Raises `UsageError` for a directory that has no fit.
    """
    if directory is None:
        return {}
    path = Path(directory) / "parameters.json"
    wrong = UsageError(f"--priors-from {directory}: {path} is not what `softrod calibrate` writes")
    try:
        told = json.loads(path.read_text(encoding="utf-8"))["parameters"]
        found = {}
        for name, e in told.items():
            if e["identifiable"] and e["recording"] is None and isinstance(e["value"], float):
                low, high = e["ci95"]
                found[name] = (e["value"], (high - low) / 4)
    except (ValueError, KeyError, TypeError, AttributeError):
        raise wrong from None
    return found


def prior_in(text: str) -> tuple[str, tuple[float, float]]:
    """NAME=MEAN:SPREAD."""
    return pair_in("prior", text, "NAME=MEAN:SPREAD, such as density=1070:20")
