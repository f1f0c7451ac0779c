"""The benchmarks: what they select and count. Their tables are in the docs."""

import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

import limits  # noqa: E402
import report  # noqa: E402
import skip  # noqa: E402
import work_precision  # noqa: E402
import work_scenes  # noqa: E402


def test_fastest_is_the_fastest_of_ours_that_is_accurate_enough():
    row = lambda family, time, largest, rms: dict(
        family=family, time=time, largest=largest, rms=rms
    )
    rows = [
        row("ours", 3.0, 1e-6, 5e-7),
        row("ours", 2.0, 1e-5, 9e-6),
        row("ours", 1.0, 1e-3, 1e-4),
        row(None, 0.1, 1e-9, 1e-9),
    ]
    assert work_precision.fastest(rows, 1e-5)["time"] == 2.0
    assert work_precision.fastest(rows, 1e-5, rms=1e-6)["time"] == 3.0
    assert work_precision.fastest(rows, 1e-8) is None


def test_errors_are_the_largest_and_the_root_mean_square():
    exact = np.zeros((4, 3))
    tip = np.array([[0.0, 0, 0], [3e-3, 4e-3, 0], [0, 0, 0], [0, 0, 0]])
    np.testing.assert_allclose(work_precision.errors(tip, exact), (5e-3, 2.5e-3))


@pytest.mark.parametrize("name", work_scenes.CASES)
def test_steps_divide_the_samples_and_names_tell_settings_apart(name):
    case = work_scenes.CASES[name]()
    settings = [*case.settings, *case.fine]
    assert len({setting.name for setting in settings}) == len(settings)
    if case.duration is not None:
        for setting in settings:
            for whole in (case.sample, 1e3 * case.duration):
                parts = whole / setting.step
                assert abs(parts - round(parts)) < 1e-9


def test_absent_parts_are_not_in_the_program():
    programs = skip.programs()
    full, some, least, flat = [
        skip.count_equations(skip.trace(*programs[name])[0].jaxpr)
        for name in ("everything", "no tendons", "gravity only", "planar, inextensible")
    ]
    assert full > some > least, (full, some, least)
    assert full > flat, (full, flat)
    unknowns = {name: skip.count_unknowns(*programs[name]) for name in programs}
    assert unknowns["everything"] == 22 and unknowns["no tendons"] == 16
    assert unknowns["no gravity"] == 18 and unknowns["everything, static"] == 16
    assert unknowns["inextensible"] == 19 and unknowns["inextensible, static"] == 13
    assert unknowns["planar"] == 10 and unknowns["planar, static"] == 7
    assert unknowns["planar, inextensible"] == 8 and unknowns["planar, inextensible, static"] == 5


def test_operations_are_counted():
    x, count = jnp.ones((3, 4)), lambda f, *a: limits.operations(jax.make_jaxpr(f)(*a).jaxpr)
    assert count(lambda x: x @ jnp.ones((4, 5)), x) == 2 * 3 * 4 * 5
    assert count(lambda x: jnp.sin(x) + x, x) == 24
    assert count(lambda x: x.T.reshape(2, 6), x) == 0
    twice = lambda x: jax.lax.fori_loop(0, 7, lambda _, x: 2 * x, x)
    assert count(jax.jit(twice), x) == 7 * 12
    with pytest.raises(ValueError, match="while"):
        count(lambda x: jax.lax.while_loop(lambda x: x[0, 0] < 1, lambda x: 2 * x, x), x)


def test_tables_go_between_their_markers(tmp_path, monkeypatch, capsys):
    page = tmp_path / "page.md"
    page.write_text("before\n<!-- times: begin -->\nold\n<!-- times: end -->\nafter\n")
    monkeypatch.setattr(report, "PAGES", tmp_path)
    monkeypatch.setattr(sys, "argv", ["timing.py"])
    report.publish("times", "page.md", "new")
    assert "old" in page.read_text() and capsys.readouterr().out == "new\n"
    sys.argv.append("--write-docs")
    report.publish("times", "page.md", "new")
    assert page.read_text() == ("before\n<!-- times: begin -->\nnew\n<!-- times: end -->\nafter\n")
    with pytest.raises(ValueError, match="sizes: begin"):
        report.publish("sizes", "page.md", "new")
