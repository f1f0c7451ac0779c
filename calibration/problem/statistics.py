"""What the measured tips tell by themselves, before anything is simulated."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from calibration.data.onset import white_noise
from calibration.problem.batch import Batch

# A result that leaves less than this part of the tip's motion (rms), or less than so many standard
# deviations of the noise, is taken for the right one.
UNEXPLAINED, _NOISE = 0.15, 1.5


@dataclass(frozen=True, eq=False)
class DataStatistics:
    """Sizes of the measured motion and of its noise, over all recordings of a batch."""

    batch: Batch

    @cached_property
    def weights(self) -> Float[np.ndarray, "recordings samples all"]:
        """Factors of the residuals; 0 where nothing was measured."""
        return np.asarray(self.batch.weights)

    @cached_property
    def samples(self) -> float:
        """Samples with at least one coordinate of the tip, each counting by its weight."""
        return float(np.sum(np.max(self.weights[..., :3] ** 2, axis=-1)))

    @cached_property
    def noise(self) -> float:
        """Standard deviation [m] of a coordinate's noise, from second differences."""
        used = np.asarray(self.batch.used)[..., :3]
        measured = np.any(used, axis=1, keepdims=True)
        used = np.all(used | ~measured, axis=-1) & np.any(used, axis=-1)
        tips = [np.asarray(tip)[u] for tip, u in zip(self.batch.tip, used, strict=True)]
        return float(np.median([white_noise(tip) for tip in tips]))

    @cached_property
    def motion_rms(self) -> float:
        """Root mean square distance of the measured tips from their mean [m]."""
        w = self.weights[..., :3] ** 2
        mean = np.sum(w * self.batch.tip, axis=1) / np.maximum(np.sum(w, axis=1), 1e-12)
        about = np.asarray(self.batch.tip) - mean[:, None]
        return float(np.sqrt(np.sum(w * about**2) / self.samples))

    def explained(self, loss: float, part: float = UNEXPLAINED) -> bool:
        """Whether a loss [m^2] leaves less than `part` of the motion (rms), or no more than
        noise."""
        noise = float(_NOISE * np.sqrt(3) * self.noise)
        return loss < max(part * self.motion_rms, noise) ** 2 * self.samples
