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
    check_writable,
    grid,
    note,
    positive,
    prepare_jax,
    print_json,
    reason,
)
from calibration.cli.solve import UNSTABLE

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
        "--out", metavar="FILE.csv", help="write the motion of tip and markers, as a log"
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
    """Inputs as of `_inputs`, and the `Trajectory`: None without an equilibrium to start from.

    `reason`: "successful", or why not.
    """

    steps: int
    tensions: Any
    pressures: Any
    trajectory: Any
    reason: str


def simulated(args, scene) -> Simulated:
    """The motion that the options of this command ask for."""
    import softrod_jax as sr

    options = _solver_options(args)
    steps, tensions, pressures = _inputs(args, scene)
    initial = None
    if args.from_static:
        first = _row(tensions, 0), _row(pressures, 0)
        initial = sr.solve_static(scene, *first, throw=False, **grid(args))
        if int(initial.result) != 0:
            why = f"--from-static: {reason(initial.result)}"
            return Simulated(steps, tensions, pressures, None, why)
        if not bool(initial.stats["stable"]):
            note(f"--from-static: {UNSTABLE}")
        # The motion goes on where the equilibrium was found.
        options["method"] = initial.method
    trajectory = sr.simulate(
        scene,
        tensions=_row(tensions, slice(1, None)),
        pressures=_row(pressures, slice(1, None)),
        steps=steps,
        initial=initial,
        throw=False,
        **options,
    )
    return Simulated(steps, tensions, pressures, trajectory, reason(trajectory.result, moving=True))


def run(args) -> int:
    if args.out is not None:
        check_writable(args.out)
    prepare_jax()
    import numpy as np

    import softrod_jax as sr

    scene = sr.load_scene(args.scene)
    motion = simulated(args, scene)
    steps, tensions, pressures, traj = motion.steps, *motion[1:4]
    if traj is None:
        return _report(args, motion.reason, [0.0], [None], 0, 0, None)
    succeeded = int(traj.result) == 0
    failed_step = None if succeeded else int(traj.failed_step)
    tips = np.array(traj.tip_positions)
    if failed_step is not None:
        tips[failed_step + 1 :] = np.nan  # the last iterates of a failed step are no motion
    if args.out is not None:
        names = [marker.name for marker in scene.markers or ()]
        tracks = {name: np.array(traj.markers[name].positions) for name in names}
        for track in tracks.values():
            track[np.isnan(tips).any(axis=1)] = np.nan
        _write(args.out, scene, np.asarray(traj.ts), tensions, pressures, tips, tracks)
    rows = [None if np.isnan(tip).any() else tip.tolist() for tip in tips]
    error = float(traj.stats["time_error"][-1])
    if succeeded and error > _LARGE_ERROR:
        note(
            f"the tip's error is estimated at {error:.2g} lengths of the rod: take a smaller --dt, "
            "or give a --tolerance"
        )
    return _report(args, motion.reason, traj.ts.tolist(), rows, steps, failed_step, error)


def _inputs(args, scene):
    """Number of steps, tensions (steps + 1, tendons) and pressures (steps + 1, chambers).

    Row 0 is at t = 0, row k at the end of step k; None where the scene has none or nothing is
    given.
    """
    import numpy as np

    if args.log is None:
        if args.duration is None:
            raise UsageError("--duration is needed (only a --log has one of its own)")
        steps = _whole_steps(args, args.duration)
        return steps, *(
            None if x is None else np.tile(x, (steps + 1, 1)) for x in actuation(args, scene)
        )
    if args.tension is not None or args.pressure is not None:
        raise UsageError("--log already gives the inputs: leave --tension and --pressure out")
    from calibration.data.loading import load_recording

    log = load_recording(args.log, scene, need_tip=False)
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
    return steps, *(
        None if x is None else np.stack([np.interp(ts, clock, c) for c in x.T], axis=1)
        for x in (log.tensions, log.pressures)
    )


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


def _row(inputs, index):
    return None if inputs is None else inputs[index]


def _write(path, scene, ts, tensions, pressures, tips, tracks) -> None:
    """The motion with the columns of a log of this scene: actuators not used are at zero."""
    import numpy as np

    from calibration.data.recording import write_log

    if tensions is None and scene.tendons is not None:
        tensions = np.zeros((len(ts), scene.tendons.count))
    if pressures is None and scene.chambers is not None:
        pressures = np.zeros((len(ts), scene.chambers.count))
    write_log(path, ts, tensions, pressures, tips, tracks)


def _report(args, result, ts, tips, steps, failed_step, error) -> int:
    if args.json:
        print_json(
            {
                "result": result,
                "t_s": ts,
                "tip_position": tips,
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
