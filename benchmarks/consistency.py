"""Whether errors are as large as their covariances say, and how far that is left to chance.

The mean over runs of normalised squares of errors (NEES) is held to its bounds of 95 % at each time
(Bar-Shalom, Li & Kirubarajan, Estimation with Applications to Tracking and Navigation, 5.4). At
about 95 % of times it should be within. How far from 95 % that share may be depends on how errors
hang together in time, and is found here from the measured ones.
"""

import numpy as np
from scipy.stats import chi2


def bounds(runs, n):
    """Of the mean of `runs` normalised squares of `n` errors, in 95 % of cases."""
    return chi2.ppf([0.025, 0.975], runs * n) / runs


def inside(nees, runs, n):
    """Whether means over `runs` of normalised squares of `n` errors are within their bounds."""
    low, high = bounds(runs, n)
    return (nees > low) & (nees < high)


def nees_if_right(off, rng, sets=2000):
    """NEES, (sets, steps), of filters whose covariances are right: how much is chance?

    - `off`: measured errors, (runs, steps, n). What is taken from them is how they hang together
      in time, which says how far the share of times within the bounds scatters.

    Sums of whole runs, with normal weights, are normal and hang together like these; they are
    scaled to have the covariance one at each time. Of few runs, distant times hang together by
    chance: too little for that share, but the mean over all times would scatter too much.
    """
    runs, steps, n = off.shape
    roots = np.linalg.cholesky(np.einsum("rki,rkj->kij", off, off) / runs)
    scaled = np.linalg.solve(roots[None], off[..., None])[..., 0].reshape(runs, -1)
    scaled = scaled / np.sqrt(runs)
    draw = lambda: (rng.standard_normal((runs, runs)) @ scaled).reshape(runs, steps, n)
    return np.array([(draw() ** 2).sum(2).mean(0) for _ in range(sets)])


def told(name, found):
    """Of normalised squares and errors, (runs, steps, ..): how they lie in their bounds."""
    (runs, steps), off = found.shape[:2], found[:, :, 2:]
    n, late = off.shape[2], steps // 2
    nees, right = found[:, :, 0].mean(0), nees_if_right(off, np.random.default_rng(0))
    force_rms = 1e3 * np.sqrt((off[:, late:, :3] ** 2).sum(2).mean())
    error = found[:, :, 0].mean(1).std(ddof=1) / np.sqrt(runs)
    print(
        f"{name}: NEES {nees.mean():.2f} +- {error:.2f} in the mean of all times, {nees[0]:.2f} in "
        f"the first step, {nees[-1]:.2f} at the end, {nees.max():.2f} at most (step "
        f"{nees.argmax() + 1}); NIS {found[:, :, 1].mean():.2f} of 6; force {force_rms:.1f} mN rms "
        "in the second half"
    )
    low, high = bounds(runs, n)
    for part, times in (("all times", slice(None)), ("the second half", slice(late, None))):
        share = inside(nees[times], runs, n).mean()
        chance = inside(right[:, times], runs, n).mean(1)
        least, most = np.quantile(chance, [0.025, 0.975])
        print(
            f"  bounds {low:.2f} to {high:.2f} hold at {100 * share:.0f} % of {part}; if "
            f"covariances were right, at {100 * chance.mean():.1f} % in the mean, at "
            f"{100 * least:.0f} to {100 * most:.0f} % in 95 % of such sets, and in "
            f"{100 * np.mean(chance <= share):.0f} % of them at no more than here",
            flush=True,
        )
    told_tails(found[:, :, 0], n)
    if n > 3:
        rms = 100 * np.sqrt((off[:, :, 3] ** 2).mean(0))
        at = [k for k in (10, 20, 50, 100) if k <= steps]
        print("modulus, rms:", ", ".join(f"{rms[k - 1]:.1f} % off after {k / 100} s" for k in at))


def told_tails(nees, n):
    """Whether single runs, (runs, steps), are further off, and more often, than chi-square."""
    above = [100 * np.mean(nees > chi2.ppf(q, n)) for q in (0.95, 0.99, 0.999)]
    print(
        f"  of one run at one time: variance {nees.var():.2f} of {2 * n}; beyond the bounds of "
        f"95, 99 and 99.9 %: {above[0]:.2f}, {above[1]:.2f}, {above[2]:.2f} %"
    )


def told_together(found, runs):
    """Of several sets of `runs`: the shares of each, and all as one set."""
    n = found.shape[2] - 2
    sets = np.split(found[:, :, 0], len(found) // runs)
    shares = [inside(own.mean(0), runs, n).mean() for own in sets]
    shown = ", ".join(f"{100 * x:.0f}" for x in shares)
    print(f"bounds hold at {shown} % of times, {100 * np.mean(shares):.1f} % in the mean of sets")
    told("all of these", found)
