"""Which of several models the data ask for: information criteria, and what was kept aside.

A model with more numbers always leaves less. By how much less it must be follows from how many
independent measurements there are, and residuals of neighbouring samples are not independent. So
the criteria count the measurements that the residuals are worth, n, as of the model that leaves
least: what a poorer model leaves out is no noise. With k fitted numbers, clocks and frames of
recordings and the size of the noise among them, and the mean square s of the residuals,

    AICc = n log s + 2 k + 2 k (k + 1) / (n - k - 1),    BIC = n log s + k log n

(Schwarz 1978; Hurvich and Tsai 1989). Only differences mean anything. A richer model is asked for
if its BIC is lower by more than `MARGIN`, if every number that it adds is identified, and if it
does not predict what was kept aside worse.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

# Below this a difference of BIC is not worth more than a bare mention (Kass and Raftery 1995).
MARGIN = 2.0
_STRONG, _VERY_STRONG = 6.0, 10.0
# A prediction is worse if it leaves more by this part.
_WORSE = 1.05


@dataclass(frozen=True)
class Candidate:
    """What the fit of one model says.

    - `numbers`: how many were fitted, those of clocks and frames among them.
    - `measurements`: how many there are; `effective`: how many independent ones the residuals are
      worth. `mean_square`: of the residuals, in a unit that all candidates share.
    - `rms_m` [m]: by recording, or of all postures. `held_out_m` [m]: of what was kept aside.
    - `vague`: names of fitted numbers that are not identified.
    - `trouble`: why it cannot be chosen, or "".
    """

    name: str
    numbers: int
    measurements: int
    effective: float
    mean_square: float
    rms_m: Mapping[str, float]
    held_out_m: Mapping[str, float] = field(default_factory=dict)
    vague: tuple[str, ...] = ()
    trouble: str = ""

    @property
    def predicted(self) -> float | None:
        """Root mean square [m] of the errors of all that was kept aside; None if nothing was."""
        if not self.held_out_m:
            return None
        return float(np.sqrt(np.mean(np.square(list(self.held_out_m.values())))))


@dataclass(frozen=True)
class Verdict:
    """Candidates in the order given, with `aicc` and `bic` relative to the lowest of each (infinite
    where there is no value), for `effective` independent measurements; the
    name of the one that is asked for, and why, in sentences."""

    candidates: tuple[Candidate, ...]
    effective: float
    aicc: tuple[float, ...]
    bic: tuple[float, ...]
    chosen: str
    sentences: tuple[str, ...]


def judged(candidates: Sequence[Candidate]) -> Verdict:
    """The verdict on two candidates or more. Raises `ValueError` for fewer."""
    if len(candidates) < 2:
        raise ValueError("compare: at least two models are needed")
    n = min(candidates, key=lambda c: (bool(c.trouble), c.mean_square)).effective
    k = np.array([c.numbers + 1 for c in candidates])
    spread = n * np.log([c.mean_square for c in candidates])
    left = n - k - 1
    enough = left > 0
    small = np.where(enough, 2 * k * (k + 1) / np.where(enough, left, 1), np.inf)
    aicc, bic = spread + 2 * k + small, np.where(enough, spread + k * np.log(n), np.inf)
    if not np.any(enough):
        bic = k * np.log(n)  # nothing can be told: the fewest numbers
    chosen, reasons = _chosen(candidates, bic)
    return Verdict(
        candidates=tuple(candidates),
        effective=float(n),
        aicc=_relative(aicc),
        bic=_relative(bic),
        chosen=candidates[chosen].name,
        sentences=tuple(_sentences(candidates, bic, chosen, reasons, n)),
    )


def _relative(values: np.ndarray) -> tuple[float, ...]:
    least = np.min(values)
    return tuple((values - (least if np.isfinite(least) else 0.0)).tolist())


def _chosen(candidates: Sequence[Candidate], bic: np.ndarray) -> tuple[int, dict[int, str]]:
    """Which candidate is asked for, and why others are not, though their BIC is lower."""
    rank = lambda c, b: (not np.isfinite(c.mean_square), c.numbers, b)
    order = sorted(range(len(bic)), key=lambda i: rank(candidates[i], bic[i]))
    usable = [i for i in order if not candidates[i].trouble]
    best, reasons = (usable or order)[0], {}
    for i in usable:
        new, old = candidates[i], candidates[best]
        margin = MARGIN if new.numbers > old.numbers else 0.0
        if not bic[i] < bic[best] - margin:
            continue
        vague = [name for name in new.vague if name not in old.vague]
        if vague:
            reasons[i] = f"{', '.join(vague)}: not identified, so that it stands for something else"
        elif _predicts_worse(new, old):
            reasons[i] = (
                f"it predicts what was kept aside to {_mm(new.predicted)}, worse than "
                f"{_mm(old.predicted)}"
            )
        else:
            best = i
            reasons.pop(i, None)
    return best, reasons


def _predicts_worse(new: Candidate, old: Candidate) -> bool:
    a, b = new.predicted, old.predicted
    return a is not None and b is not None and a > _WORSE * b


def _sentences(candidates, bic, chosen: int, reasons, n: float):
    """Why, the verdict first."""
    own = candidates[chosen]
    said = f"The data ask for {own.name}"
    others = [i for i in range(len(bic)) if i != chosen and not candidates[i].trouble]
    if own.trouble:
        yield f"The data ask for none of these models: {own.name}: {own.trouble}."
    elif not others:
        yield f"{said}, of which alone there is a fit."
    else:
        rival = min(others, key=lambda i: bic[i])
        apart = bic[rival] - bic[chosen]
        if apart > 0:
            said += f": its BIC is lower by {apart:.1f} than that of {candidates[rival].name}"
            said += f", the next, which is {_strength(apart)}"
        yield f"{said}."
    for i in others:
        other, apart = candidates[i], bic[i] - bic[chosen]
        if i in reasons and apart < -MARGIN:
            yield f"BIC would prefer {other.name} by {-apart:.1f}, but {reasons[i]}."
        elif abs(apart) <= MARGIN:
            yield f"{other.name} is not told apart from it: their BIC differ by {abs(apart):.1f}."
        if _predicts_worse(own, other):
            yield (
                f"What was kept aside contradicts that: {other.name} predicts it to "
                f"{_mm(other.predicted)}, {own.name} to {_mm(own.predicted)}."
            )
        if _ended_worse(other, candidates):
            yield (
                f"{other.name} leaves more than a model with fewer numbers: it does not contain "
                "that one, or its search ended in a worse place (more starts tell)."
            )
    for c, value in zip(candidates, bic, strict=True):
        if c.trouble and c is not own:
            lower = bic[chosen] - value
            so_far = f", though its BIC is lower by {lower:.1f} so far" if lower > MARGIN else ""
            vague = f"; not identified: {', '.join(c.vague)}" if c.vague else ""
            yield f"{c.name} is not chosen{so_far}: {c.trouble}{vague}."
    if n <= own.numbers + 2:
        yield (
            f"The residuals are worth {n:.0f} independent measurements, fewer than there are "
            "numbers: record more."
        )


def _ended_worse(other: Candidate, candidates: Sequence[Candidate]) -> bool:
    return any(
        c.numbers < other.numbers and c.mean_square < other.mean_square and not c.trouble
        for c in candidates
    )


def _strength(apart: float) -> str:
    """Kass and Raftery's words for a difference of BIC."""
    if apart > _VERY_STRONG:
        return "very strong evidence"
    if apart > _STRONG:
        return "strong evidence"
    return "evidence" if apart > MARGIN else "not worth more than a mention"


def _mm(value: float | None) -> str:
    return "nothing" if value is None else f"{1e3 * value:.3g} mm"
