"""A scene and a recording to try the calibration on; `make_example.py` made the recording."""

from pathlib import Path

_HERE = Path(__file__).parent


def example_paths() -> tuple[Path, list[Path]]:
    """The scene file and the logs of the bundled example."""
    return _HERE / "robot.toml", [_HERE / "swing.csv"]
