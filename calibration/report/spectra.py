"""Amplitudes by frequency: of a motion, and of what a fit leaves of it."""

import numpy as np


def amplitudes(times: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies [Hz], (n,), and the amplitude there of each column of `values`, (n, columns).

    `times` [s], (T,); `values`, (T, columns): missing samples (NaN) are interpolated, means and a
    column without two samples are taken out. A sine of amplitude 1 has a peak of about 1.
    """
    interval = float(np.median(np.diff(times)))
    even = np.arange(times[0], times[-1] + interval / 2, interval)
    window = np.hanning(len(even))
    found = np.zeros((len(even) // 2 + 1, values.shape[1]))
    for j, column in enumerate(values.T):
        measured = np.isfinite(column)
        if np.count_nonzero(measured) > 1:
            path = np.interp(even, times[measured], column[measured])
            found[:, j] = np.abs(np.fft.rfft(window * (path - np.mean(path))))
    return np.fft.rfftfreq(len(even), interval)[1:], found[1:] / (np.sum(window) / 2)
