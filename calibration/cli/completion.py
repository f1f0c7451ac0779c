"""Print what completes commands, options and names of parameters by the tabulator key.

bash, zsh   eval "$(softrod completion bash)"       a line for ~/.bashrc, with zsh for ~/.zshrc
fish        softrod completion fish | source        a line for ~/.config/fish/config.fish
"""

import os

from calibration.cli.common import UsageError
from calibration.parameters.names import NAMES

_SHELLS = ("bash", "zsh", "fish")


def add_arguments(parser) -> None:
    parser.add_argument("shell", metavar="SHELL", choices=_SHELLS, help=", ".join(_SHELLS))


def run(args) -> int:
    try:
        from argcomplete.shell_integration import shellcode
    except ImportError as e:
        raise UsageError(f"{e}: pip install 'softrod_jax[calibration]'") from None
    print(shellcode(["softrod"], shell=args.shell))
    return 0


def complete(parser, commands) -> None:
    """Answer the shell and end, if it is the shell that asks; `commands`: their parsers."""
    if "_ARGCOMPLETE" not in os.environ:
        return
    import argcomplete

    for command in commands.values():
        for option in command._actions:
            if option.metavar == "NAME,..":
                option.completer = _names
    argcomplete.autocomplete(parser)


def _names(prefix: str, **_) -> list[str]:
    """Of parameters, separated by commas: the last one is completed."""
    done, comma, _ = prefix.rpartition(",")
    return [done + comma + name for name in NAMES if name not in done.split(",")]
