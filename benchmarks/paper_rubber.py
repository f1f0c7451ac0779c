"""The article's robot of rubber: is there an equilibrium at the printed modulus and 3 N?

    python benchmarks/paper_rubber.py [--write-docs]

One tendon of `hybrid_robot` is pulled, without gravity and pressure, as far as there is an
equilibrium: linear, neo-Hookean, and of Mooney and Rivlin with C1 = C2, all of the same modulus at
small strain. Each equilibrium is that of the one before it, pulled a little more.
"""

import dataclasses
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402
import matplotlib  # noqa: E402
import numpy as np  # noqa: E402
from report import publish  # noqa: E402

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402

import softrod_jax as sr  # noqa: E402

E, STEPS, MOST = 5e4, 60, 3.0
FIGURE = Path(__file__).parent / "figures" / "paper_rubber.png"
LAWS = {
    "linear": None,
    "neo-Hookean": sr.NeoHookean(E / 3),
    "Mooney-Rivlin, C1 = C2": sr.MooneyRivlin(E / 12, E / 12),
}


def equilibria(law) -> sr.StaticSolution:
    """The robot under 0 to 3 N of its first tendon."""
    scene = dataclasses.replace(sr.hybrid_robot(), gravity=None, young_modulus=E)
    if law is not None:
        own = dict(young_modulus=None, poisson_ratio=None, material=law)
        scene = dataclasses.replace(scene, **own)
    one = jnp.linspace(0.0, MOST, STEPS + 1)
    tensions = one[:, None] * jnp.array([1.0, 0.0, 0.0])
    count = 1 if scene.chambers is None else scene.chambers.count
    pressures = None if scene.chambers is None else jnp.zeros((STEPS + 1, count))
    return sr.solve_path(scene, tensions, pressures, method=sr.Collocation(24), throw=False)


def row(name: str, path) -> str:
    """A line of the table: the last equilibrium there is."""
    solved = np.asarray(path.result) == int(sr.RESULTS.successful)
    last = len(solved) - 1 if solved.all() else int(np.argmin(solved)) - 1
    strains, s = np.asarray(path.strains)[last], np.asarray(path.arc_lengths)[last]
    radius = float(sr.hybrid_robot().section.radius)
    bent = np.hypot(strains[:, 3], strains[:, 4])
    fibres = strains[:, 2] - radius * bent, strains[:, 2] + radius * bent
    turn = np.degrees(np.sum(np.diff(s) * (bent[1:] + bent[:-1]) / 2))
    return (
        f"| {name} | {MOST * last / STEPS:.2f} N | {strains[:, 2].mean():.2f} | {turn:.0f}° | "
        f"{fibres[0].min():.2f} to {fibres[1].max():.2f} |"
    )


def draw(paths) -> None:
    figure, axes = plt.subplots(1, len(paths), figsize=(8, 3.9), sharey=True, layout="constrained")
    shade = plt.get_cmap("viridis_r")
    for ax, (name, path) in zip(axes, paths.items(), strict=True):
        for k in range(0, STEPS + 1, STEPS // 6):
            if int(path.result[k]) == int(sr.RESULTS.successful):
                x, _, z = 1e3 * np.asarray(path.positions)[k].T
                ax.plot(x, z, color=shade(k / STEPS), label=f"{MOST * k / STEPS:g} N")
        ax.set(title=name, xlabel="x [mm]", aspect="equal", xlim=(-8, 72))
        ax.grid(alpha=0.3)
        ax.legend(fontsize=8)
    axes[0].set_ylabel("z [mm]")
    figure.savefig(FIGURE, dpi=130)


def main() -> None:
    paths = {name: equilibria(law) for name, law in LAWS.items()}
    head = ["| law | pulled by | stretch of the axis | turn of the tip | fibres |"]
    head += ["| --- | --- | --- | --- | --- |"]
    table = "\n".join(head + [row(*x) for x in paths.items()])
    draw(paths)
    publish("rubber", "materials.md", table)


if __name__ == "__main__":
    main()
