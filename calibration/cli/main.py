"""`softrod`: one command, its subcommands, and the one place that turns errors into words.

Exit status: 0 done, 1 the computation did not succeed, 2 bad input. Results go to stdout,
`softrod: error: ..` and notes to stderr. JAX is imported by the commands that compute, so that
`--help` is immediate.
"""

import argparse
import os
import re
import sys

from calibration.cli import (
    calibrate,
    completion,
    design,
    doctor,
    film,
    grid,
    importing,
    init,
    modes,
    plot,
    simulate,
    solve,
    view,
)
from calibration.cli.common import UsageError
from calibration.cli.order import like, positions_first
from calibration.cli.verbosity import VERBOSE, add_verbose, shown

COMMANDS = {
    "init": init,
    "import": importing,
    "solve": solve,
    "simulate": simulate,
    "modes": modes,
    "plot": plot,
    "film": film,
    "view": view,
    "grid": grid,
    "calibrate": calibrate,
    "design": design,
    "doctor": doctor,
    "completion": completion,
}


class _Parser(argparse.ArgumentParser):
    """A parser whose complaints go the way of all others."""

    def __init__(self, *args, **options):
        super().__init__(*args, **options)
        # Before Python 3.14, argparse takes -1e4 for an option, and -10000 not.
        self._negative_number_matcher = re.compile(r"-(\.?\d|inf|nan)", re.IGNORECASE)

    def error(self, message):
        raise UsageError(f"{message} (see `{self.prog} --help`)")


def main(argv: list[str] | None = None) -> int:
    """Run the command line `argv` (`sys.argv[1:]` if None) and return the exit status.

    `--help` and `--version` raise `SystemExit(0)`, as usual with argparse.
    """
    try:
        words = sys.argv[1:] if argv is None else list(argv)
        parser, commands = _parsers()
        completion.complete(parser, commands)
        if not words:
            parser.print_help()
            return 0
        name = next((word for word in words if word not in VERBOSE), None)
        if name in commands:
            words.remove(name)
            args = commands[name].parse_args(positions_first(commands[name], words))
        elif name is None or name.startswith("-"):
            args = parser.parse_args(words)
        else:
            hint, all_of = like(name, commands), ", ".join(commands)
            raise UsageError(f"no command {name!r}{hint} (the commands: {all_of})")
        with shown(getattr(args, "verbose", 0)):
            status = args.run(args)
        sys.stdout.flush()
        return status
    except BrokenPipeError:
        # The reader of stdout (`| head`) has left; nothing more can be said to it.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except OSError as e:
        where = f"{e.filename}: " if e.filename is not None else ""
        return _fail(f"{where}{e.strerror or e}")
    except ValueError as e:
        # Both packages raise ValueError, and its subclasses, for bad input and say what to do.
        return _fail(str(e))
    except MemoryError:
        return _fail("more memory is needed than there is: give less data, or larger steps")
    except KeyboardInterrupt:
        print("softrod: interrupted", file=sys.stderr)
        return 130


class _Version(argparse.Action):
    """Looks the version up only when it is asked for."""

    def __call__(self, parser, *_):
        from importlib.metadata import PackageNotFoundError, version

        try:
            print(f"softrod {version('softrod_jax')}")
        except PackageNotFoundError:
            print("softrod, not installed")
        parser.exit()


def _parsers() -> tuple[argparse.ArgumentParser, dict[str, argparse.ArgumentParser]]:
    """The parser of the whole command line, and those of the commands."""
    parser = _Parser(
        prog="softrod",
        description="Soft robots as Cosserat rods: statics, dynamics and calibration.",
        epilog="`softrod COMMAND --help` describes one command.",
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="print the version")
    add_verbose(parser)
    found = {}
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for name, command in COMMANDS.items():
        sub = commands.add_parser(
            name,
            help=(command.__doc__ or "").split("\n", 1)[0],
            description=command.__doc__,
            epilog=getattr(command, "EPILOG", None),
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        command.add_arguments(sub)
        add_verbose(sub)
        sub.set_defaults(run=command.run)
        found[name] = sub
    return parser, found


def _fail(message: str) -> int:
    print(f"softrod: error: {message}", file=sys.stderr)
    return 2
