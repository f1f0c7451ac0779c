"""How much memory a fit asks for, told before it is taken.

A motion is kept at every step, with its derivatives by all unknowns: a log of a million rows asks
for more than a machine has, which ends the process without a word.
"""

import math
import os

from calibration.data.recording import RecordingError

# More than this [bytes], or than half of what the machine has, is not taken.
_MOST = 4e9
# Numbers kept of each step, interval of the grid and derivative, as measured.
_A_STEP = 70


def motion_bytes(recordings: int, steps: int, intervals: int, unknowns: int) -> float:
    """What the motions of all recordings take, with their derivatives by so many unknowns each."""
    return 8.0 * recordings * (steps + 1) * intervals * _A_STEP * (1 + unknowns)


def check_memory(needed: float, what: str, remedy: str) -> None:
    """Raise `RecordingError` if `needed` [bytes] is too much: `what` needs it, `remedy` helps."""
    most = min(_MOST, 0.5 * _of_this_machine())
    if needed > most:
        raise RecordingError(
            f"{what}: about {needed / 1e9:.3g} GB of memory are needed, and at most "
            f"{most / 1e9:.3g} GB are taken; {remedy}"
        )


def _of_this_machine() -> float:
    """The memory of this machine, in bytes; infinite where it does not say."""
    try:
        return float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    except (AttributeError, OSError, ValueError):  # not a POSIX system
        return math.inf
