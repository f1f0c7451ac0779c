"""What a calibration hands back: numbers with intervals and verdicts, and how they came about."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

import softrod_jax as sr
from calibration.data.recording import Recording
from calibration.data.selection import Selection
from calibration.experiment.drift import Drift
from calibration.experiment.setup import Setup
from calibration.inference.explain import Explanation
from calibration.inference.posterior import Posterior
from calibration.inference.profile import Profile
from calibration.inference.uncertainty import IDENTIFIED
from calibration.report.text import html_table, summary_text
from calibration.search.checkpoint import Checkpoint
from calibration.search.multistart import Start


@dataclass(frozen=True)
class Estimate:
    """One fitted parameter, in its unit; arrays (n,) where components are scaled together.

    - `name`: of the parameter; `recording`: which one it belongs to, None for all.
    - `ci95`: ends of the 95 % interval; None for a side on which the data set no bound.
    - `verdict`: "identified", "bounded above only", "bounded below only", "not identifiable".
    - `standard_error`: in theta, about relative for what is positive.
    - `step_shift`, `grid_shift`: how far the value would move with half the time step and with
      twice the grid, as parts of the half width of its interval (of a half width of 1 in theta if
      that is larger); None if not checked.
    """

    name: str
    recording: str | None
    value: float | np.ndarray
    ci95: tuple
    initial: float | np.ndarray
    unit: str
    verdict: str
    standard_error: float
    step_shift: float | None
    grid_shift: float | None

    @property
    def identifiable(self) -> bool:
        return self.verdict == IDENTIFIED


@dataclass(frozen=True, eq=False)
class Compared:
    """A quantity, (rows, numbers), simulated and measured, NaN where missing; `rms` of their
    difference, and `noise`, as stated; all in `unit`."""

    simulated: Float[np.ndarray, "rows numbers"]
    measured: Float[np.ndarray, "rows numbers"]
    rms: float
    noise: float
    unit: str


def compared(simulated, measured, noise: float, unit: str, size: float = 1.0) -> Compared:
    """The two side by side; `size`: of the rms in `unit`, where the numbers have another one."""
    both = np.isfinite(simulated - measured)
    rms = float(np.sqrt(np.mean((simulated - measured)[both] ** 2))) if both.any() else np.nan
    return Compared(simulated, measured, size * rms, noise, unit)


@dataclass(frozen=True, eq=False)
class RodMotion:
    """The rod's simulated motion, as it is drawn, and what was seen of it.

    - `ts` [s], (rows,), from the start of the simulation; `positions` [m], (rows, outputs, 3),
      `quaternions`, (rows, outputs, 4), and `strains`, (rows, outputs, 6), at `arc_lengths` [m].
    - `seen_times` [s], (n,), on the same clock, and `seen` [m], (n, 3): the measured tip in the
      scene's frame, NaN where a coordinate is missing.
    - `inputs`: by the name of their kind, (rows, actuators), as recorded.
    - `carried`: by name, (rows, 7), where the base and obstacles are, as recorded.
    """

    ts: np.ndarray
    positions: np.ndarray
    quaternions: np.ndarray
    strains: np.ndarray
    arc_lengths: np.ndarray
    seen_times: np.ndarray
    seen: np.ndarray
    inputs: dict[str, np.ndarray]
    carried: dict[str, np.ndarray] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class RecordingFit:
    """One recording and its fit at the samples that were used (n,).

    - `times` [s], the recording's clock; `measured` and `simulated` [m], (n, 3); NaN where a
      coordinate is missing. The simulated tip is seen in the recording's frame.
    - `weights`, (n, 3): 1, less for outliers if the loss is robust.
    - `others`: what else was measured: `Compared` by key (`calibration.data.quantities`).
    - `curve_times` [s] and `curve` [m]: the simulated tip on a fine grid, for plots.
    - `rmse` [m]: root mean square distance, every sample counting the same; `rmse_axes` [m], (3,).
    - `time_offset` [s]: for a recording with inputs, how much later than its inputs the tip's
      clock says they began; for a release, when it happened on the recording's clock.
    - `time_offset_ci95` [s], None if it was not fitted.
    - `drift`: a `calibration.experiment.drift.Drift` of each channel that was allowed to, by name.
    - `tip_offset` [m] and `frame_rotation` [rad], (3,) each: how the recording's frame was moved
      to fit (`calibration.experiment.alignment`); None if the recording knows where the clamp is.
    - `beginning`: how it was taken to begin.
    - `frame_fitted`: they were fitted to this recording; else, where it was kept aside, they are
      those of the fitted ones, and `rmse_own_frame` [m] is what a frame of its own would leave.
    - `motion`: the rod's motion, for plots and films.
    - `band` [m], two of (n, 3): between which ends 95 % of samples of the tip are expected, by the
      spread of the posterior and the noise; None where no posterior was asked for.
    """

    name: str
    recording: Recording
    selection: Selection
    times: np.ndarray
    measured: np.ndarray
    simulated: np.ndarray
    weights: np.ndarray
    curve_times: np.ndarray
    curve: np.ndarray
    rmse: float
    rmse_axes: np.ndarray
    time_offset: float
    time_offset_ci95: tuple[float, float] | None
    drift: dict[str, Drift]
    tip_offset: np.ndarray | None
    frame_rotation: np.ndarray | None
    motion: RodMotion
    others: Mapping[str, Compared] = field(default_factory=dict)
    beginning: str = ""
    frame_fitted: bool = True
    rmse_own_frame: float | None = None
    band: tuple[np.ndarray, np.ndarray] | None = None


@dataclass(frozen=True)
class PosturesFit:
    """What is left of equilibria that were fitted together with motions.

    - `name`, `source`: of the logs; `rows`, and of how many there is no equilibrium, `unsolved`.
    - `rmse_m` [m]: root mean square distance of all markers; `rmse_by_marker`, by name.
    - `noise_scale`: how many times larger residuals are than the noise that was stated.
    - `simulated`, `measured` [m]: (rows, markers, 3), markers in the order of `rmse_by_marker`; NaN
      where missing.
    """

    name: str
    source: str
    rows: int
    unsolved: int
    rmse_m: float
    rmse_by_marker: Mapping[str, float]
    noise_scale: float
    simulated: Float[np.ndarray, "rows markers 3"]
    measured: Float[np.ndarray, "rows markers 3"]


@dataclass(frozen=True, eq=False)
class Fit:
    """The outcome of `calibrate`.

    - `scene`: the scene with the fitted values; `setup`: the same with what surrounds it. Values
      of single recordings are not in them. What is not identifiable is there as it was at the
      start, or at the end of its interval that is nearest to that.
    - `parameters`: an `Estimate` by label: the name, with @ and the recording if it is its own.
    - `recordings`, `held_out`: a `RecordingFit` each. `rmse_m` [m], `time_offset_s` [s], by name.
    - `result`: "converged", or why the fit stopped. `loss`: "squares", "huber" or "tukey".
    - `history`: after each evaluation: stage, rms distance [m] and values by label.
    - `correlation`, (parameters, parameters), in the order of `parameters`.
    - `samples`, `effective_samples`: coordinates fitted, and how many independent ones they are
      worth.
    - `profiles`: by label, those asked for. `starts`: those of a multi-start, the best first.
    - `explanations`: what else would explain the residuals; None if that was not asked for.
    - `material`: name of the material whose range values were compared with, or None.
    - `dt` [s]: the time step used, by recording; `method`: the grid along the rod.
      `resolution_note`: what finer simulations say, if it is more than shifts of parameters.
    - `priors`: mean and standard deviation of what was known beforehand, by parameter; `conflicts`:
      those that the recordings contradict, and by how many standard deviations.
    - `postures`: equilibria that were fitted as well; None without any.
    - `posterior`: draws of it; None if nobody asked.
    - `checkpoint`: that of the fit, for `calibration.report.writing.write_report` to remove.
    - `seconds`: how long the fit took.
    """

    scene: sr.Scene
    setup: Setup
    parameters: dict[str, Estimate]
    recordings: tuple[RecordingFit, ...]
    held_out: tuple[RecordingFit, ...]
    result: str
    optimiser: str
    loss: str
    iterations: int
    evaluations: int
    history: list[dict]
    correlation: np.ndarray
    samples: int
    effective_samples: float
    profiles: Mapping[str, Profile]
    starts: tuple[Start, ...]
    explanations: tuple[Explanation, ...] | None
    material: str | None
    dt: dict[str, float]
    method: sr.Collocation
    resolution_note: str
    priors: Mapping[str, tuple[float, float]]
    conflicts: Mapping[str, float]
    checkpoint: Checkpoint
    seconds: float
    postures: PosturesFit | None = None
    posterior: Posterior | None = None

    def summary(self) -> str:
        """The parameters and what is left of each recording, as lines of text."""
        return summary_text(self)

    def _repr_html_(self) -> str:
        """What a notebook shows."""
        return html_table(self)

    @property
    def rmse_m(self) -> dict[str, float]:
        return {r.name: r.rmse for r in self.recordings}

    @property
    def time_offset_s(self) -> dict[str, float]:
        return {r.name: r.time_offset for r in self.recordings}
