"""The motion from rest under inputs from a log, or constant from t = 0.

Inputs of a log are interpolated linearly in time; the step that ends at t takes their value at
t, because the time stepping is implicit: it balances the forces at the end of a step. Time 0 is
the log's first sample.
"""

import math
import os
import sys
from typing import Any, NamedTuple

from calibration.cli.common import (
    UsageError,
    actuation,
    add_actuation,
    add_grid,
    add_mapping,
    check_writable,
    given_inputs,
    grid,
    note,
    note_self_contact,
    positive,
    prepare_jax,
    print_json,
    reason,
)
from calibration.cli.solve import UNSTABLE
from calibration.cli.waiting import waiting

# A motion is kept as a whole, on every point of its grid. More than this [bytes], or than half of
# what the machine has, is a typing error, and would fill the memory before it is noticed.
_MOST_MEMORY = 4e9
# Estimated errors of the tip, in lengths of the rod, that deserve a note.
_LARGE_ERROR = 1e-2


def add_arguments(parser) -> None:
    parser.add_argument("scene", metavar="SCENE.toml", help="the scene file")
    parser.add_argument(
        "--log",
        metavar="INPUT.csv",
        help="inputs from this log: linear in time, a step takes the value at its end",
    )
    add_mapping(parser)
    add_actuation(parser)
    parser.add_argument("--dt", type=positive, required=True, metavar="S", help="time step [s]")
    parser.add_argument(
        "--duration",
        type=positive,
        metavar="S",
        help="simulated time [s]; needed unless there is a log, whose length is the default",
    )
    parser.add_argument(
        "--from-static",
        action="store_true",
        help="start from the equilibrium under the first inputs, not from the straight rod",
    )
    parser.add_argument(
        "--out",
        metavar="FILE.csv",
        help="write the motion of tip and markers, and the forces of obstacles, as a log",
    )
    parser.add_argument("--json", action="store_true", help="the whole motion as JSON on stdout")
    add_grid(
        parser,
        "divide the steps, and refine the grid, until the tip's estimated error is below X lengths "
        "of the rod",
    )
    parser.add_argument(
        "--alpha",
        type=float,
        metavar="A",
        help="BDF-alpha in time, -0.5 to 0, instead of SDIRK of order 3",
    )


def _solver_options(args) -> dict:
    """What the command line says about the time stepping, for `simulate`."""
    import softrod_jax as sr

    options = {"dt": args.dt, **grid(args)}
    if args.alpha is not None:
        if not -0.5 <= args.alpha <= 0:
            raise UsageError(f"--alpha {args.alpha:g}: from -0.5 to 0")
        options["scheme"] = sr.BDFAlpha(args.alpha)
    return options


class Simulated(NamedTuple):
    """Steps, inputs and poses as of `_Driven`, and the `Trajectory`: None without an equilibrium to
    start from.

    `scene`: with its base where it is at first. `reason`: "successful", or why not.
    """

    scene: Any
    steps: int
    inputs: Any
    carried: Any
    trajectory: Any
    reason: str

    @property
    def moves(self) -> dict:
        """Where the base and obstacles are carried in its steps, as `simulate` is told."""
        from calibration.data.carried import moves_of

        return moves_of({name: poses[1:] for name, poses in self.carried.items()})


class _Driven(NamedTuple):
    """How many steps there are, and what drives the rod: inputs, (steps + 1, actuators) each, and
    by name where the base and obstacles are carried, (steps + 1, 7).

    Row 0 is at t = 0, row k at the end of step k; None where the scene has none or nothing is
    given.
    """

    steps: int
    inputs: Any
    carried: dict


def simulated(args, scene) -> Simulated:
    """The motion that the options of this command ask for."""
    import softrod_jax as sr
    from calibration.data.carried import at_first

    options = _solver_options(args)
    steps, inputs, carried = _driven(args, scene)
    scene = at_first(scene, carried)
    motion = Simulated(scene, steps, inputs, carried, None, "")
    initial = None
    if args.from_static:
        initial = sr.solve_static(scene, *_rows(inputs, 0), throw=False, **grid(args))
        if int(initial.result) != 0:
            why = f"--from-static: {reason(initial.result)}"
            return motion._replace(reason=why)
        if not bool(initial.stats["stable"]):
            note(f"--from-static: {UNSTABLE}")
        # The motion goes on where the equilibrium was found.
        options["method"] = initial.method
    with waiting(f"simulating {steps} steps of {args.dt:g} s"):
        trajectory = sr.simulate(
            scene,
            **_rows(inputs, slice(1, None))._asdict(),
            **motion.moves,
            steps=steps,
            initial=initial,
            throw=False,
            **options,
        )
        code = int(trajectory.result)  # waits for it
    return motion._replace(trajectory=trajectory, reason=reason(code, moving=True))


def run(args) -> int:
    if args.out is not None:
        check_writable(args.out)
    prepare_jax()
    import numpy as np

    import softrod_jax as sr
    from softrod_jax.scene.contacts import contact_names

    scene = sr.load_scene(args.scene)
    motion = simulated(args, scene)
    steps, traj = motion.steps, motion.trajectory
    if traj is None:
        return _report(args, motion.reason, [0.0], [None], 0, 0, None, {})
    succeeded = int(traj.result) == 0
    failed_step = None if succeeded else int(traj.failed_step)
    tips = np.array(traj.tip_positions)
    if failed_step is not None:
        tips[failed_step + 1 :] = np.nan  # the last iterates of a failed step are no motion
    known = np.asarray(np.isfinite(tips[:, 0]))
    obstacles = contact_names(scene.contacts)
    if args.out is not None:
        names = [marker.name for marker in scene.markers or ()]
        tracks = {name: np.array(traj.markers[name].positions) for name in names}
        forces = {x: np.array(traj.contact_forces[x]) for x in obstacles}
        for values in (*tracks.values(), *forces.values()):
            values[~known] = np.nan
        _write(args.out, motion, tips, tracks, forces)
    rows = [None if np.isnan(tip).any() else tip.tolist() for tip in tips]
    error = float(traj.stats["time_error"][-1])
    if succeeded and error > _LARGE_ERROR:
        note(
            f"the tip's error is estimated at {error:.2g} lengths of the rod: take a smaller --dt, "
            "or give a --tolerance"
        )
    note_self_contact(scene, traj, None if failed_step is None else failed_step + 1)
    only_known = lambda values: [
        x if there else None for x, there in zip(np.asarray(values).tolist(), known, strict=True)
    ]
    more = {}
    if motion.inputs.pulls is not None:
        more["tensions"] = only_known(traj.tensions)
    if obstacles:
        more["contact_force"] = {x: only_known(traj.contact_forces[x]) for x in obstacles}
    ts = traj.ts.tolist()
    return _report(args, motion.reason, ts, rows, steps, failed_step, error, more)


def _driven(args, scene) -> _Driven:
    import numpy as np

    from softrod_jax.scene.inputs import Inputs

    if args.log is None:
        if args.mapping is not None:
            raise UsageError("--mapping: how to read a --log; give one, or leave it out")
        if args.duration is None:
            raise UsageError("--duration is needed (only a --log has one of its own)")
        steps = _whole_steps(args, args.duration)
        given = actuation(args, scene)
        constant = Inputs(*(None if x is None else np.tile(x, (steps + 1, 1)) for x in given))
        return _Driven(steps, constant, {})
    if given_inputs(args):
        raise UsageError(
            f"--log already gives the inputs: leave {' and '.join(given_inputs(args))} out"
        )
    from calibration.data.carried import poses_at
    from calibration.data.loading import load_recording

    log = load_recording(args.log, scene, mapping=args.mapping, need_tip=False)
    for assumption in log.notes:
        note(f"--log {args.log}: {assumption}")
    clock = log.times - log.times[0]
    duration = args.duration if args.duration is not None else float(clock[-1])
    if duration == 0:
        raise UsageError(f"--log {args.log}: one row has no duration; give --duration")
    steps = _whole_steps(args, duration)
    ts = args.dt * np.arange(steps + 1)
    if ts[-1] > clock[-1] + 0.5 * args.dt:
        note(f"the log ends after {clock[-1]:g} s; its last inputs are held from there on")
    at_steps = lambda x: np.stack([np.interp(ts, clock, c) for c in x.T], axis=1)
    inputs = Inputs(**{kind.name: at_steps(values) for kind, values in log.driven_by})
    return _Driven(steps, inputs, {k: poses_at(ts, clock, x) for k, x in log.carried.items()})


def _whole_steps(args, duration: float) -> int:
    dt, ratio = args.dt, duration / args.dt
    _check_memory(args, duration, ratio)
    steps = round(ratio)
    if duration < dt and not math.isclose(ratio, 1):
        raise UsageError(f"--duration {duration:g} is shorter than one step, --dt {dt:g}")
    if not math.isclose(ratio, steps, rel_tol=1e-9):
        note(
            f"{duration:g} s are not a whole number of steps of {dt:g} s: simulating {steps} "
            f"steps, {steps * dt:g} s"
        )
    return steps


def _check_memory(args, duration: float, steps: float) -> None:
    import softrod_jax as sr

    nodes = 1 + (args.intervals or sr.Collocation().intervals)
    # Of each step: thrice the strains at 4 points of an interval, all that is seen at the nodes,
    # and the tip as text; as measured.
    each = 8 * (72 * nodes + 25 * nodes + 100)
    most = min(_MOST_MEMORY, 0.5 * _memory())
    if steps * each > most:
        raise UsageError(
            f"--duration {duration:g} with --dt {args.dt:g} makes {steps:.3g} steps, which take "
            f"{steps * each / 1e9:.3g} GB of memory; at most {most / 1e9:.3g} GB, or "
            f"{most / each:.3g} steps, are allowed: give a larger --dt, or parts of the duration "
            "one by one"
        )


def _memory() -> float:
    """The memory of this machine, in bytes; infinite where it does not say."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, OSError, ValueError):  # not a POSIX system
        return math.inf


def _rows(inputs, index):
    return inputs._replace(
        **{name: x[index] for name, x in inputs._asdict().items() if x is not None}
    )


def _write(path, motion: Simulated, tips, tracks, forces) -> None:
    """The motion with the columns of a log of this scene: actuators not used are at zero."""
    import numpy as np

    from softrod_jax.scene.inputs import filled
    from softrod_jax.scene.logs import write_log

    ts = np.asarray(motion.trajectory.ts)
    inputs = filled(motion.scene, motion.inputs, (len(ts),))._asdict()
    write_log(
        path,
        ts,
        **inputs,
        tip_positions=tips,
        markers=tracks,
        contact_forces=forces,
        carried=motion.carried,
    )


def _report(args, result, ts, tips, steps, failed_step, error, more) -> int:
    """`more`: what is known at `ts` beside the tip, of a scene that has it."""
    if args.json:
        print_json(
            {
                "result": result,
                "t_s": ts,
                "tip_position": tips,
                **more,
                "steps": steps,
                "failed_step": failed_step,
                "time_error": None if failed_step is not None else error,
            }
        )
    elif failed_step is None:
        tip = ", ".join(f"{x:.6g}" for x in tips[-1])
        print(f"{steps} steps of {args.dt:g} s: {result}")
        print(f"tip at {ts[-1]:g} s: ({tip}) m")
        if args.out is not None:
            print(f"written to {args.out}")
    else:
        when = f"step {failed_step}, from {ts[failed_step]:g} s: " if steps else ""
        print(f"softrod: failed: {when}{result}", file=sys.stderr)
    return 0 if failed_step is None else 1
