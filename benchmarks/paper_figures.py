"""The pictures of paper.py: Figures 6 to 9, and what the moduli allow."""

import matplotlib.pyplot as plt
import numpy as np
from scipy.interpolate import make_interp_spline

COLOURS = ("#0072b2", "#d55e00", "#009e73")  # the three tendons
MM, MPA = 1e3, 1e-6
LIMITS = {"xlim": (-70, 70), "ylim": (-70, 70), "zlim": (0, 105), "box_aspect": (140, 140, 105)}


def draw(study, directory) -> None:
    """Write paper_*.png of a `paper.Study` into `directory`."""
    figures = {
        "modulus": modulus(study),
        "figure_6": shapes(study),
        "figure_7": path(study),
        "figure_8": workspace(study),
        "figure_9": components(study),
    }
    for name, figure in figures.items():
        figure.savefig(directory / f"paper_{name}.png", dpi=110)
        plt.close(figure)


def modulus(study):
    """Shapes under one tendon at two moduli, and which modulus and length would do what."""
    figure, (printed, stated, plane) = plt.subplots(
        1, 3, figsize=(12, 4), width_ratios=(1, 1, 1.1), layout="constrained"
    )
    for axes, rest, E in (
        (printed, study.printed, study.printed_E),
        (stated, study.stated, study.stated_E),
    ):
        shade = plt.get_cmap("viridis_r")
        ok = np.flatnonzero(rest.result[0, 0] == 0)
        wanted = np.array([0.0, 0.1, 0.2, 0.3, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0])
        chosen = {int(np.abs(study.levels[ok] - tension).argmin()) for tension in wanted}
        for k in sorted(chosen):
            x, _, z = curve(rest.positions[0, 0, k]).T
            tension = study.levels[k]
            axes.plot(x, z, color=shade(tension / 3), label=f"{tension:.1f} N", lw=1.8)
        axes.plot(*(MM * rest.tip[0, 0, ok][:, [0, 2]].T), "k:", lw=1)
        axes.set(xlim=(-15, 95), ylim=(-20, 105), aspect="equal", xlabel="x [mm]")
        axes.set(title=f"E = {E * MPA:.2f} MPa, one tendon, to {study.levels[ok[-1]]:.1f} N")
        axes.legend(fontsize=7, loc="upper right")
        axes.grid(alpha=0.3)
    printed.set(ylabel="z [mm]")

    E, curvature, longest = study.bending
    for turn, name in ((0.25, "quarter"), (0.5, "half"), (1.0, "one"), (2.0, "two")):
        length = 2 * np.pi * turn / curvature
        plane.plot(MM * length, E * MPA, color="0.6", lw=1)
        at = np.searchsorted(length, (0.022, 0.025, 0.05, 0.1)[int(np.log2(turn) + 2)])
        at = min(at, len(E) - 1)
        side = dict(ha="right", va="bottom") if name == "quarter" else dict(ha="left", va="top")
        place = (MM * length[at], E[at] * MPA)
        plane.annotate(f"{name} turn", place, fontsize=8, color="0.3", **side)
    lines = (
        (study.printed_E, "printed", "#d55e00", "-"),
        (study.moduli[1, "solid"], "3 N on one tendon", "black", "--"),
        (study.moduli[3, "solid"], "3 N on all three", "black", "-"),
    )
    for value, name, colour, style in lines:
        plane.axhline(value * MPA, color=colour, ls=style, lw=1.3, label=name)
    plane.plot(MM * longest, E * MPA, color="#0072b2", label="tip moves one way to 3 N")
    plane.plot(MM * study.length, study.stated_E * MPA, "o", color="#0072b2")
    plane.set(xscale="log", yscale="log", xlim=(10, 200), ylim=(0.04, 1))
    plane.set(xlabel="length [mm]", ylabel="E [MPa]", title="needed: E above the line")
    plane.set_xticks((10, 20, 50, 100, 200), ("10", "20", "50", "100", "200"))
    plane.set_yticks((0.05, 0.1, 0.2, 0.5, 1), ("0.05", "0.1", "0.2", "0.5", "1"))
    plane.minorticks_off()
    plane.legend(fontsize=7, loc="upper left")
    plane.grid(alpha=0.3)
    return figure


def shapes(study):
    """Figure 6: the robot at rest and with each tendon at 3 N, at 10 kPa."""
    figure = plt.figure(figsize=(8.5, 6.4))
    titles = "(a) no tension", "(b) tendon 1, 3 N", "(c) tendon 2, 3 N", "(d) tendon 3, 3 N"
    for k, title in enumerate(titles):
        axes = _space(figure, (2, 2, k + 1), title)
        at = (0, 1, 0) if k == 0 else (k - 1, 1, -1)
        _robot(axes, study.stated, at, study)
    figure.suptitle(f"E = {study.stated_E * MPA:.2f} MPa, 10 kPa", fontsize=10)
    figure.subplots_adjust(0.0, 0.04, 0.96, 0.97, 0.0, 0.08)
    return figure


def path(study):
    """Figure 7: the tip while the three tendons are pulled in turn, at 10 kPa."""
    figure = plt.figure(figsize=(10, 4.3))
    axes = _space(figure, (1, 2, 1), "")
    above = figure.add_subplot(1, 2, 2)
    pulls = np.clip(((study.ts - 0.5) // 4.5).astype(int), 0, 2)
    tip = MM * study.tips[1]
    for i, colour in enumerate(COLOURS):
        part = tip[pulls == i]
        axes.plot(*part.T, color=colour, lw=1.6)
        above.plot(part[:, 0], part[:, 1], color=colour, label=f"tendon {i + 1}", lw=1.2)
        static = MM * study.stated.tip[i, 1]
        above.plot(static[:, 0], static[:, 1], ".", color=colour, ms=4)
        _line(axes, study.stated, (i, 1, -1), "0.55")
    _line(axes, study.stated, (0, 1, 0), "0.55")
    above.plot([], [], ".", color="0.3", ms=4, label="equilibria")
    above.set(aspect="equal", xlabel="tip x [mm]", ylabel="tip y [mm]")
    above.legend(fontsize=8)
    above.grid(alpha=0.3)
    figure.suptitle(f"E = {study.stated_E * MPA:.2f} MPa, 10 kPa, 0 to 3 to 0 N", fontsize=10)
    figure.subplots_adjust(0.0, 0.12, 0.97, 0.92, 0.1)
    return figure


def workspace(study):
    """Figure 8: the tips of the fifteen experiments, and of all tensions together."""
    figure = plt.figure(figsize=(11.5, 3.9))
    tests = _space(figure, (1, 3, 1), "(a) fifteen experiments")
    for i, colour in enumerate(COLOURS):
        for pressure in range(5):
            tests.plot(*(MM * study.stated.tip[i, pressure].T), ".-", color=colour, ms=3, lw=0.7)
    cloud = _space(figure, (1, 3, 2), "(b) three tendons together, 10 kPa")
    tip = MM * study.workspace.tip.reshape(-1, 3)
    n = study.workspace.tip.shape[0]
    levels = np.linspace(0, 3, n)
    total = np.add.outer(np.add.outer(levels, levels), levels).ravel()
    style = {"c": total, "cmap": "viridis", "s": 3, "lw": 0, "alpha": 0.6}
    cloud.scatter(*tip.T, **style)
    above = figure.add_subplot(1, 3, 3)
    dots = above.scatter(tip[:, 0], tip[:, 1], **style)
    above.set(aspect="equal", xlabel="tip x [mm]", ylabel="tip y [mm]")
    above.set_title(f"from above: {len(tip):,} tensions", fontsize=9)
    above.grid(alpha=0.3)
    figure.colorbar(dots, ax=above, label="sum of the tensions [N]", shrink=0.8)
    figure.subplots_adjust(0.0, 0.12, 0.97, 0.9, 0.22)
    return figure


def components(study):
    """Figure 9: shapes under three tensions, and x and y of the tip in time."""
    figure = plt.figure(figsize=(12, 4))
    axes = _space(figure, (1, 2, 1), "(a) 1, 2 and 3 N, 10 kPa")
    _line(axes, study.stated, (0, 1, 0), "0.4")
    for i, colour in enumerate(COLOURS):
        for tension, alpha in ((1, 0.4), (2, 0.7), (3, 1.0)):
            k = int(np.abs(study.levels - tension).argmin())
            _line(axes, study.stated, (i, 1, k), colour, alpha)
    place = {"left": 0.56, "right": 0.985, "top": 0.93, "bottom": 0.13, "hspace": 0.25}
    rows = figure.subplots(3, 1, sharex=True, gridspec_kw=place)
    for i, (row, letter) in enumerate(zip(rows, "bcd", strict=True)):
        begin = 0.5 + 4.5 * i
        during = (study.ts >= begin) & (study.ts <= begin + 4.5)
        for j, name in enumerate("xy"):
            values = MM * study.tips[1, during, j]
            row.plot(study.ts[during] - begin, values, color=COLOURS[j], label=f"tip {name}")
        row.set_ylabel("[mm]")
        row.set_ylim(-75, 75)
        row.set_title(f"({letter}) tendon {i + 1}", fontsize=9, pad=2)
        row.grid(alpha=0.3)
    rows[0].legend(fontsize=8, ncols=2, loc="lower right")
    rows[-1].set_xlabel("time since the pull began [s]")
    return figure


def curve(positions, points=160):
    """Positions [mm], (points, 3), by a spline through the nodes."""
    s = np.linspace(0, 1, len(positions))
    return MM * make_interp_spline(s, positions, k=5)(np.linspace(0, 1, points))


def _space(figure, place, title):
    axes = figure.add_subplot(*place, projection="3d")
    axes.set(**LIMITS)
    axes.set(xticks=(-50, 0, 50), yticks=(-50, 0, 50), zticks=(0, 50, 100))
    axes.set(xlabel="x [mm]", ylabel="y [mm]", zlabel="z [mm]")
    axes.tick_params(labelsize=7)
    axes.set_title(title, fontsize=9, y=0.93)
    axes.view_init(elev=22, azim=-80)
    return axes


def _line(axes, rest, at, colour, alpha=1.0):
    axes.plot(*curve(rest.positions[at]).T, color=colour, alpha=alpha, lw=2)


def _robot(axes, rest, at, study):
    """The body as a tube, with its tendons."""
    middle = curve(rest.positions[at], 60)
    frames = make_interp_spline(np.linspace(0, 1, len(rest.quaternions[at])), rest.quaternions[at])
    x, y = _directions(frames(np.linspace(0, 1, 60)))
    angle = np.linspace(0, 2 * np.pi, 25)
    ring = lambda radius, angle: (
        middle[:, None]
        + MM * radius * (np.cos(angle)[:, None] * x[:, None] + np.sin(angle)[:, None] * y[:, None])
    )
    tube = ring(study.radius, angle)
    axes.plot_surface(*np.moveaxis(tube, -1, 0), color="#c9d6e3", alpha=0.35, lw=0)
    tendons = ring(study.offset, 2 * np.pi * np.arange(3) / 3)
    for i, colour in enumerate(COLOURS):
        pulled = at[2] != 0 and at[0] == i
        axes.plot(*tendons[:, i].T, color=colour, lw=2.4 if pulled else 1)


def _directions(quaternions):
    """The section's x and y axes, (n, 3) each, of quaternions (w, x, y, z)."""
    w, a, b, c = (quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)).T
    x = np.stack([1 - 2 * (b * b + c * c), 2 * (a * b + w * c), 2 * (a * c - w * b)], axis=1)
    y = np.stack([2 * (a * b - w * c), 1 - 2 * (a * a + c * c), 2 * (b * c + w * a)], axis=1)
    return x, y
