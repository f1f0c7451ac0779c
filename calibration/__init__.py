"""Calibration of softrod_jax scenes from recordings of real robots.

Names are imported when first used, so that `softrod --help` does not wait for JAX.
"""

import logging
from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from calibration.comparison import Comparison as Comparison
    from calibration.comparison import compare as compare
    from calibration.data.loading import load_recording as load_recording
    from calibration.data.loading import load_recordings as load_recordings
    from calibration.data.onset import detect_onset as detect_onset
    from calibration.data.recording import Recording as Recording
    from calibration.data.recording import RecordingError as RecordingError
    from calibration.fit import calibrate as calibrate
    from calibration.parameters.laws import Model as Model
    from calibration.parameters.laws import damped as damped
    from calibration.report.results import Estimate as Estimate
    from calibration.report.results import Fit as Fit
    from calibration.report.writing import write_report as write_report
    from calibration.search.minimum import CalibrationError as CalibrationError
    from softrod_jax.scene.logs import write_log as write_log

logging.getLogger(__name__).addHandler(logging.NullHandler())  # silent until it is asked for

_HOME = {
    "Recording": "calibration.data.recording",
    "RecordingError": "calibration.data.recording",
    "load_recording": "calibration.data.loading",
    "load_recordings": "calibration.data.loading",
    "write_log": "softrod_jax.scene.logs",
    "detect_onset": "calibration.data.onset",
    "calibrate": "calibration.fit",
    "compare": "calibration.comparison",
    "Comparison": "calibration.comparison",
    "Model": "calibration.parameters.laws",
    "damped": "calibration.parameters.laws",
    "CalibrationError": "calibration.search.minimum",
    "Fit": "calibration.report.results",
    "Estimate": "calibration.report.results",
    "write_report": "calibration.report.writing",
}

__all__ = list(_HOME)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str):
    if name not in _HOME:
        raise AttributeError(f"module 'calibration' has no attribute {name!r}")
    value = getattr(import_module(_HOME[name]), name)
    # Kept, also over a submodule of the same name.
    globals()[name] = value
    return value
