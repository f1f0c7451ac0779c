"""Make an obstacle of a mesh: distances on a grid, of an STL, OBJ or PLY file (extra `meshes`).

The surface must be closed. The file that is written is that of `shape = "grid"` in [[contacts]].
"""

from pathlib import Path

from calibration.cli.common import UsageError, check_writable, prepare_jax


def add_arguments(parser) -> None:
    parser.add_argument("mesh", metavar="MESH", help="a closed surface: .stl, .obj, .ply")
    parser.add_argument(
        "--spacing", type=float, required=True, metavar="M", help="between points of the grid [m]"
    )
    parser.add_argument(
        "--margin",
        type=float,
        required=True,
        metavar="M",
        help="how far around the body distances hold [m]: at least the radius of the rod",
    )
    parser.add_argument(
        "--scale",
        type=float,
        default=1.0,
        metavar="X",
        help="the mesh's unit in metres: 1e-3 for millimetres (1)",
    )
    parser.add_argument("--inside", action="store_true", help="the rod is inside of the surface")
    parser.add_argument("--out", metavar="FILE.npz", help="the grid (default: MESH.npz here)")


def run(args) -> int:
    out = args.out if args.out is not None else f"{Path(args.mesh).stem}.npz"
    if Path(out).suffix != ".npz":
        raise UsageError(f"--out {out}: expected a name that ends in .npz")
    check_writable(out)
    prepare_jax()
    import numpy as np

    import softrod_jax as sr

    grid = sr.grid_of_mesh(
        args.mesh, args.spacing, margin=args.margin, scale=args.scale, inside=args.inside
    )
    sr.save_grid(grid, out)
    shape = np.array(grid.values.shape)
    last = np.asarray(grid.origin) + args.spacing * (shape - 1)
    box = ", ".join(
        f"{name} {1e3 * a:.4g} to {1e3 * b:.4g}"
        for name, a, b in zip("xyz", np.asarray(grid.origin), last, strict=True)
    )
    print(f"{out} is written: {' x '.join(map(str, shape))} points, {box} mm")
    print(f'in the scene: [[contacts]] with shape = "grid", file = "{out}" and a stiffness')
    return 0
