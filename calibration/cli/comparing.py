"""The models that `softrod calibrate --compare` names."""

import re
from collections.abc import Sequence
from pathlib import Path

from calibration.cli.common import UsageError, names_in, note
from calibration.parameters.names import LAWS, USUAL

_OTHER_SCENE = re.compile(r"(.*\.toml)(?::(.*))?", re.IGNORECASE)


def models_in(words: Sequence[str], scene, fit: str | None, motions: bool = True) -> dict:
    """The models by name: `calibration.parameters.laws.Model` of each word, and that of --fit
    unless only laws or scenes are named. The usual laws without any word.

    `fit`: what --fit says. `motions`: whether laws of damping can be told. Raises `UsageError`.
    """
    import softrod_jax as sr
    from calibration.parameters.catalogue import choose
    from calibration.parameters.laws import Model, damped

    words = list(words) or (list(USUAL) if motions else [])
    base = names_in(fit) or None
    laws = [word for word in words if word in LAWS]
    if laws and not motions:
        raise UsageError(f"--compare {laws[0]}: an equilibrium does not tell how motion is lost")
    if not motions and base is None and any(word.startswith("+") for word in words):
        raise UsageError("--compare +NAME: besides what? name it with --fit")
    sets = [word for word in words if word not in LAWS and not _OTHER_SCENE.fullmatch(word)]
    found = damped(Model(scene, base), laws)
    if sets and (base is not None or any(word.startswith("+") for word in sets)):
        found |= _named(Model(scene, base))
    for word in words:
        other = _OTHER_SCENE.fullmatch(word)
        if other:
            names = names_in(other[2]) or base
            found[_label(other)] = Model(sr.load_scene(other[1]), names)
        elif word in sets:
            own = names_in(word.removeprefix("+"))
            first = choose(scene, base) if word.startswith("+") else ()
            found |= _named(Model(scene, (*first, *own)))
    if len(found) < 2:
        such = f"{' '.join(USUAL)}, or +drag_coefficient" if motions else "+density"
        raise UsageError(
            f"--compare {' '.join(words)}: {len(found) or 'no'} model; name at least two, such as "
            f"{such} besides what --fit names"
        )
    return found


def _named(model) -> dict:
    return {",".join(model.names): model}


def _label(other: re.Match) -> str:
    name = Path(other[1]).stem
    return f"{name}:{other[2]}" if other[2] else name


def told(words: str) -> None:
    """Says on stderr what is fitted now."""
    note(f"comparing models: {words}")
