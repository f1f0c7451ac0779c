"""Signs of life on stderr, while one compiled program runs that says nothing by itself."""

import contextlib
import sys
import threading
import time
from collections.abc import Iterator

# Without a terminal a line comes after so many seconds, and then after twice as many, and so on;
# on one, the same line is written anew.
FIRST, AGAIN = 30.0, 1.0


@contextlib.contextmanager
def waiting(what: str) -> Iterator[None]:
    """Says, while the block runs, that it does, and for how long."""
    done = threading.Event()
    on_terminal = sys.stderr.isatty()
    thread = threading.Thread(target=_say, args=(what, done, on_terminal), daemon=True)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join()


def _say(what: str, done: threading.Event, on_terminal: bool) -> None:
    begun, wait, shown = time.monotonic(), AGAIN if on_terminal else FIRST, False
    while not done.wait(wait):
        seconds = time.monotonic() - begun
        if on_terminal:
            print(f"\r{what}: {seconds:.0f} s ", end="", file=sys.stderr, flush=True)
            shown = True
        else:
            print(f"softrod: {what}: {seconds:.0f} s so far", file=sys.stderr, flush=True)
            wait = seconds
    if shown:
        print("\r\x1b[K", end="", file=sys.stderr, flush=True)
