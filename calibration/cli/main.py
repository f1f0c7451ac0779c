"""`softrod`: one command, six subcommands, and the one place that turns errors into words.

Exit status: 0 done, 1 the computation did not succeed, 2 bad input. Results go to stdout,
`softrod: error: ..` and notes to stderr. JAX is imported by the commands that compute, so that
`--help` is immediate.
"""

import argparse
import os
import re
import sys

from calibration.cli import calibrate, doctor, modes, plot, simulate, solve
from calibration.cli.common import UsageError

COMMANDS = {
    "solve": solve,
    "simulate": simulate,
    "modes": modes,
    "plot": plot,
    "calibrate": calibrate,
    "doctor": doctor,
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

    `--help` raises `SystemExit(0)`, as usual with argparse.
    """
    try:
        args = _parser().parse_args(argv)
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


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="softrod",
        description="Soft robots as Cosserat rods: statics, dynamics and calibration.",
        epilog="`softrod COMMAND --help` describes one command.",
    )
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for name, command in COMMANDS.items():
        sub = commands.add_parser(
            name,
            help=(command.__doc__ or "").split("\n", 1)[0],
            description=command.__doc__,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        command.add_arguments(sub)
        sub.set_defaults(run=command.run)
    return parser


def _fail(message: str) -> int:
    print(f"softrod: error: {message}", file=sys.stderr)
    return 2
