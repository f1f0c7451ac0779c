"""The article's experiments: the command runs, and its verdicts follow from what is solved."""

import sys
from pathlib import Path

import matplotlib
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

import paper  # noqa: E402
import paper_study  # noqa: E402


@pytest.fixture(scope="module")
def quick(tmp_path_factory):
    matplotlib.use("agg")
    directory = tmp_path_factory.mktemp("figures")
    study, rows = paper.main(paper.QUICK, directory)
    return study, rows, directory


def verdicts(rows):
    return {row.text.strip("“”"): row.verdict for row in rows}


@pytest.mark.long
def test_writes_the_figures_and_the_table(quick):
    _, rows, directory = quick
    figures = {path.stem: path.stat().st_size for path in directory.glob("*.png")}
    assert set(figures) == {"paper_modulus", *(f"paper_figure_{k}" for k in (6, 7, 8, 9))}
    assert min(figures.values()) > 10_000
    assert not any("does not agree" in row.verdict for row in rows)


def test_limits_are_those_of_the_closed_form(quick):
    study, _, _ = quick
    offsets = 4e-3 * np.exp(2j * np.pi * np.arange(3) / 3)
    product = np.real(np.outer(offsets, offsets.conj()))
    for (count, name), modulus in study.moduli.items():
        area, moment = paper_study.solid() if name == "solid" else paper_study.net()
        tensions = 3.0 * (np.arange(3) < count)
        needed = np.max((1 / area + product / moment) @ tensions)
        np.testing.assert_allclose(modulus, needed, rtol=1e-4)
    area, moment = paper_study.solid()
    pressures = np.array([0, 10e3, 20e3, 30e3, 40e3])
    push = pressures * np.pi * 1.5e-3**2
    limits = (1 + push / (0.05e6 * area)) / (1 / area + 16e-6 / moment) * 0.05e6
    np.testing.assert_allclose(study.limits, limits, rtol=1e-4)


def test_the_stated_modulus_has_the_tip_farthest_out_at_3_newtons(quick):
    study, _, _ = quick
    area, moment = paper_study.solid()
    tension = np.linspace(2.9, 3.1, 20001)
    stretch = 1 + (10e3 * np.pi * 1.5e-3**2 - tension) / (study.stated_E * area)
    curvature = tension * 4e-3 / (study.stated_E * moment)
    x = stretch / curvature * (1 - np.cos(curvature * 0.1))
    np.testing.assert_allclose(tension[np.argmax(x)], 3.0, atol=1e-3)


def test_verdicts_follow_from_the_solutions(quick):
    study, rows, _ = quick
    text = paper.TEXT
    ranges = [text[name] for name in ("fifteen", "range", "workspace", "figure 6")]
    assert {verdicts(rows)[name] for name in ranges} == {paper.BAD}
    possible = study._replace(printed=study.stated, limits=np.full(5, 3.5), cube_share=1.0)
    assert {verdicts(paper.claims(possible))[name] for name in ranges} == {paper.GOOD}

    tips = study.stated.tip + 1e-6 * np.arange(3)[:, None, None, None]
    skewed = study._replace(stated=study.stated._replace(tip=tips), tips=study.tips * [1, 1, 0.5])
    skewed.tips[:, -1] += 0.01
    changed = verdicts(paper.claims(skewed))
    for name in ("y opposed", "angle", "return"):
        assert verdicts(rows)[text[name]] == paper.GOOD
        assert changed[text[name]] != paper.GOOD
