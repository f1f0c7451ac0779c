"""Which postures to record next: those that shrink the intervals of a fit most.

The information that a posture brings follows from the derivatives of its markers, without any
measurement: D-optimal design (Fedorov, Theory of Optimal Experiments, 1972), greedily and by
exchange.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

import softrod_jax as sr
from calibration.postures.data import Postures
from calibration.postures.fitting import prepared_model, prior_information

_EXCHANGES = 50


@dataclass(frozen=True, eq=False)
class Design:
    """Chosen rows of the candidates, in the order of what they bring.

    - `rows`, (chosen,): by index. `half_widths`: of the 95 % intervals that are expected with them,
      by parameter, in theta (about relative for what is positive); `all_rows`: with all candidates.
    """

    rows: Int[np.ndarray, "chosen"]
    half_widths: dict[str, float]
    all_rows: dict[str, float]


def design_postures(
    scene: sr.Scene,
    candidates: Postures,
    *,
    fit: Sequence[str] | str,
    count: int,
    known: Sequence[int] = (),
    priors: Mapping[str, tuple[float, float]] | None = None,
    method: sr.Collocation = sr.Collocation(),  # noqa: B008
) -> Design:
    """The `count` rows of `candidates` that tell most of the parameters `fit`, at their values in
    the scene.

    - `candidates`: inputs, and any finite numbers for each marker that will be seen; `noise`
      counts.
    - `known`: rows that have been recorded already. `priors`: as of `calibrate_postures`.

    Raises `ValueError` if there are not so many rows, or none brings anything.
    """
    scene = jax.tree.map(jnp.asarray, scene)
    model = prepared_model(scene, candidates, fit, method)
    evaluation = model.evaluate(np.zeros(len(model.parameters)))
    J = np.where(evaluation.solved[:, None, None], evaluation.jacobian, 0.0)
    each = np.einsum("kni,knj->kij", J, J)
    free = [k for k in range(len(each)) if k not in known and evaluation.solved[k]]
    if not 0 < count <= len(free):
        raise ValueError(f"design: count={count}; {len(free)} rows can be chosen")
    if not np.any(each[free]):
        raise ValueError("design: no row says anything of these parameters")
    vague = np.diag([(2.0 / p.scale.largest) ** 2 for p in model.parameters])
    start = vague + prior_information(model, priors) + each[list(known)].sum(0)
    rows = chosen_rows(each, free, count, start)
    names = [p.name for p in model.parameters]
    width = lambda H: dict(zip(names, 1.96 * np.sqrt(np.diag(np.linalg.inv(H))), strict=True))
    everything = start + each[free].sum(0)
    return Design(np.array(rows), width(start + each[rows].sum(0)), width(everything))


def chosen_rows(
    each: Float[np.ndarray, "rows p p"], free: list[int], count: int, start
) -> list[int]:
    """The rows whose information, added to that of the `start`, has the largest determinant."""
    gain = lambda H: np.linalg.slogdet(H)[1]
    rows, total = [], start
    for _ in range(count):
        left = [k for k in free if k not in rows]
        best = max(left, key=lambda k: gain(total + each[k]))
        rows.append(best)
        total = total + each[best]
    for _ in range(_EXCHANGES):
        swaps = [
            (gain(total - each[a] + each[b]), i, b)
            for i, a in enumerate(rows)
            for b in free
            if b not in rows
        ]
        if not swaps or max(swaps)[0] <= gain(total) + 1e-9:
            break
        _, i, b = max(swaps)
        total = total - each[rows[i]] + each[b]
        rows[i] = b
    return rows
