"""Calibration of softrod_jax scenes from recordings of real robots.

Names are imported when first used, so that `softrod --help` does not wait for JAX.
"""

from importlib import import_module

_HOME = {
    "Recording": "calibration.data.recording",
    "RecordingError": "calibration.data.recording",
    "load_recording": "calibration.data.loading",
    "write_log": "calibration.data.recording",
    "detect_onset": "calibration.data.onset",
    "calibrate": "calibration.fit",
    "CalibrationError": "calibration.search.minimum",
    "Fit": "calibration.report.results",
    "Estimate": "calibration.report.results",
    "write_report": "calibration.report.writing",
}

__all__ = list(_HOME)


def __getattr__(name: str):
    if name not in _HOME:
        raise AttributeError(f"module 'calibration' has no attribute {name!r}")
    value = getattr(import_module(_HOME[name]), name)
    # Kept, also over a submodule of the same name.
    globals()[name] = value
    return value
