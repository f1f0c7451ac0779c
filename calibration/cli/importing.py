"""Look at any table of measurements, and write the mapping file that reads it.

  softrod import log.csv             a CSV, TSV, MAT, HDF5, Parquet or C3D file
  softrod import robot.toml log.csv  the same, compared with the robot: unit, clamp and axes

What is between cells, the decimal sign, the header and what each column is are found, by names,
units and what is plausible; what was assumed is said, and asked on a terminal. Options say what is
known. It writes FILE.map.toml, which `calibrate`, `plot` and `simulate` use by themselves, and a
picture of what they then read. Keys of a mapping:

"""

import sys
from pathlib import Path

from calibration.cli.common import UsageError, check_writable, number, positive

_KINDS = ("tension", "pressure", "pull")
_KEYS = """\
  [time]      column, unit, offset, format (of dates); or rate [Hz]
  [tip]       columns = [x, y, z] or markers; unit, axes, missing, origin or rest; time
  [[tensions]], [[pressures]], [[pulls]]   one for each actuator, in the scene's order:
              column, unit, offset, scale, time, ignore_file_unit
  [[base_markers]]  columns, position [m]: three or more, the frame is fitted to them
  [conditions]      in what the experiment differs from the scene
  [csv]       delimiter, decimal, thousands, skip_rows, header, encoding, missing
"""
__doc__ = f"{(__doc__ or '').rstrip()}\n\n{_KEYS}"


def add_arguments(parser) -> None:
    parser.add_argument("files", nargs="+", metavar="FILE", help="the table, and SCENE.toml")
    parser.add_argument("--out", metavar="FILE.map.toml", help="the mapping (default: beside FILE)")
    parser.add_argument("--force", action="store_true", help="overwrite a mapping that is there")
    parser.add_argument("--yes", action="store_true", help="ask nothing: take what is assumed")
    parser.add_argument("--no-plot", action="store_true", help="draw no picture")
    what = parser.add_argument_group("what the columns are")
    what.add_argument("--time", metavar="COLUMN", help="the time")
    what.add_argument("--time-unit", metavar="UNIT", help="s, ms, us, ns, min, h or d")
    what.add_argument("--rate", type=positive, metavar="HZ", help="samples a second, instead")
    what.add_argument("--tip", nargs=3, metavar=("X", "Y", "Z"), help="its columns; - for none")
    what.add_argument("--unit", metavar="UNIT", help="of the tip: m, cm, mm, um or in")
    for name in _KINDS:
        what.add_argument(
            f"--{name}",
            nargs="+",
            metavar="COLUMN",
            help=f"{name}s, in order; none: there are none",
        )
        what.add_argument(f"--{name}-unit", metavar="UNIT", help="if the file does not say it")
    what.add_argument(
        "--pulley", type=positive, metavar="M", help="radius [m], where pulls are angles"
    )
    what.add_argument(
        "--axes",
        metavar="AXES",
        help="which axes of the file are the scene's x, y, z: --axes=-y,x,z",
    )
    what.add_argument(
        "--origin", type=number, nargs=3, metavar=("X", "Y", "Z"), help="the clamp, as in the file"
    )
    what.add_argument(
        "--rest", action="store_true", help="put the rest at the beginning at the straight tip"
    )
    text = parser.add_argument_group("how text is written")
    text.add_argument("--decimal", choices=(".", ","), help="the decimal sign")
    text.add_argument("--delimiter", metavar="SIGN", help="between cells; or tab, space")
    text.add_argument("--encoding", metavar="NAME", help="such as latin-1")
    text.add_argument("--skip-rows", type=int, metavar="N", help="lines before the header")


def run(args) -> int:
    from calibration.data.loading import mapping_name
    from calibration.data.mapping_writing import mapping_text

    scene_path, path = _files(args.files)
    out = Path(args.out) if args.out is not None else mapping_name(path)
    check_writable(str(out))
    if out is None or (out.exists() and not args.force):
        raise UsageError(f"--out {out}: is there already; give another name, or --force")
    scene = _scene(scene_path)
    sniffed = _sniffed(args, path)
    found = _found(args, sniffed.table, scene)
    notes = (*sniffed.notes, *found.notes)
    for note in notes:
        print(f"- {note}")
    unused = _unused(sniffed.table, found)
    if unused:
        print(f"- not used: {', '.join(unused)}")
    out.write_text(mapping_text(Path(path).name, found, _csv(args, sniffed), notes), "utf-8")
    print(f"the mapping is in {out}")
    _check(args, path, out, scene, told=notes)
    print(f"next: {_next(scene_path, path, out, found)}")
    return 0


def _files(files) -> tuple[str | None, str]:
    scenes = [f for f in files if f.lower().endswith(".toml")]
    logs = [f for f in files if f not in scenes]
    if len(scenes) > 1 or len(logs) != 1:
        raise UsageError(f"{' '.join(files)}: give one table, and at most one SCENE.toml")
    return (scenes[0] if scenes else None), logs[0]


def _scene(path):
    if path is None:
        return None
    from calibration.cli.common import prepare_jax

    prepare_jax()
    import softrod_jax as sr

    return sr.load_scene(path)


def _sniffed(args, path):
    from calibration.data.sniffing import sniff

    names = {"tab": "\t", "space": " ", "\\t": "\t"}
    delimiter = None if args.delimiter is None else names.get(args.delimiter, args.delimiter)
    if delimiter is not None and len(delimiter) != 1:
        raise UsageError(f"--delimiter {delimiter!r}: one character, or tab or space")
    return sniff(path, delimiter, args.decimal, args.encoding, args.skip_rows)


def _csv(args, sniffed) -> dict[str, str | int | bool]:
    """What the reader cannot find by itself, for the mapping."""
    keys = {
        "delimiter": {"\t": "tab", " ": "space"}.get(sniffed.delimiter or "", sniffed.delimiter),
        "decimal": sniffed.decimal,
        "encoding": args.encoding,
        "skip_rows": args.skip_rows,
        "header": None if sniffed.header else False,
    }
    return {key: value for key, value in keys.items() if value is not None}


def _found(args, table, scene):
    """The guess, with what options and answers say instead of it."""
    from calibration.data.guesses import guess
    from calibration.data.placing import place
    from softrod_jax.scene.inputs import KINDS

    counts = None if scene is None else {kind.name: kind.count(scene) for kind in KINDS}
    found = _told(args, table, guess(table, counts))
    asks = sys.stdin.isatty() and not args.yes
    if asks:
        found = _asked_for_columns(args, table, found)
    if found.time is None and found.rate is None and table.interval is None:
        raise UsageError(f"--time: no column looks like the time; name one of {_names(table)}")
    if found.tip is None and not found.inputs:
        raise UsageError(
            "--tip: no three columns look like the tip, and none like inputs; name them, of "
            f"{_names(table)}"
        )
    found = place(table, found, scene, args.unit)
    if asks and "unit" in found.doubts:
        answer = _ask("unit of the tip", found.unit)
        found = place(table, found, scene, answer)
    if "pulley" in found.doubts and args.pulley is None:
        raise UsageError("--pulley: pulls are angles; give the radius [m] of their pulleys")
    return found


def _told(args, table, found):
    """The guess with what options say."""
    from dataclasses import replace

    from calibration.data.guesses import input_of, time_of

    if args.rate is not None:
        found = replace(found, rate=args.rate, time=None).noted(f"{args.rate:g} samples a second")
    elif args.time is not None or args.time_unit is not None:
        column = found.time if args.time is None else table.find(args.time, key="--time")
        if column is not None:
            found = time_of(table, _without(found, "time is"), column, args.time_unit)
    if args.tip is not None:
        tip = tuple("" if c in ("-", "none") else table.find(c, key="--tip") for c in args.tip)
        found = replace(_without(found, "the tip is"), tip=tip)
        found = found.noted(f"the tip is {', '.join(map(repr, tip))}")
    for name in _KINDS:
        columns, unit, kind = getattr(args, name), getattr(args, f"{name}_unit"), f"{name}s"
        if columns is None and unit is None:
            continue
        if columns is None:
            columns = [part.column for part in found.inputs.get(kind, [])]
        found = _without(found, f"{name} ")
        found = replace(found, inputs={k: v for k, v in found.inputs.items() if k != kind})
        for column in [] if columns == ["none"] else columns:
            found = input_of(table, found, kind, table.find(column, key=f"--{name}"), unit)
    if args.pulley is not None:
        pulls = [
            replace(p, scale=args.pulley * p.scale) if p.unit is None and p.scale else p
            for p in found.inputs.get("pulls", [])
        ]
        found = replace(found, inputs={**found.inputs, "pulls": pulls} if pulls else found.inputs)
    place = {
        "axes": args.axes,
        "origin": None if args.origin is None else tuple(args.origin),
        "rest": args.rest or None,
    }
    place = {key: value for key, value in place.items() if value is not None}
    if "rest" in place:
        place["origin"] = None
    return replace(found, **place) if place else found


def _without(found, beginning: str):
    """The guess without what it said of something that is now known."""
    from dataclasses import replace

    return replace(found, notes=tuple(n for n in found.notes if not n.startswith(beginning)))


def _asked_for_columns(args, table, found):
    """The guess with answers to what is uncertain."""
    if args.time is None and args.rate is None and (found.time is None or "time" in found.doubts):
        if table.interval is None:
            args.time = _ask(f"column of the time, of {_names(table)}", found.time)
            args.time_unit = _ask("unit of the time (s, ms, us, ..)", found.time_unit or "s")
    if args.tip is None and (found.tip is None or "tip" in found.doubts):
        usual = None if found.tip is None else " | ".join(found.tip)
        answer = _ask(f"three columns of the tip, with | between them, of {_names(table)}", usual)
        args.tip = [part.strip() for part in answer.split("|")] if answer else None
        if args.tip is not None and len(args.tip) != 3:
            raise UsageError(f"{answer}: three columns are needed, such as X | Y | Z")
    for name in _KINDS:
        if getattr(args, name) is None and f"{name}s" in found.doubts:
            parts = found.inputs.get(f"{name}s", [])
            unit = _ask(
                f"unit of {', '.join(p.column for p in parts)}, taken for {name}s",
                parts[0].unit if parts else None,
            )
            setattr(args, f"{name}_unit", unit or None)
    return _told(args, table, found)


def _ask(question: str, usual: str | None) -> str:
    try:
        answer = input(f"{question}{'' if usual is None else f' [{usual}]'}: ").strip()
    except EOFError:
        raise UsageError(f"{question}: no answer; give it as an option, or --yes") from None
    return answer or usual or ""


def _names(table) -> str:
    return ", ".join(map(repr, table.columns))


def _unused(table, found) -> list[str]:
    used = {found.time, *(found.tip or ())}
    used |= {part.column for parts in found.inputs.values() for part in parts}
    return [repr(column) for column in table.columns if column not in used]


def _check(args, path, mapping, scene, told) -> None:
    """Read the file as the mapping says, draw what is then read, and say what was not `told`."""
    import numpy as np

    from calibration.data.loading import load_recording

    if scene is None and args.rest:
        print("with rest = true it can only be read beside the scene")
        return
    recording = load_recording(path, scene, mapping=mapping, need_tip=False)
    times = recording.times
    print(f"{len(times)} samples, {times[0]:.6g} to {times[-1]:.6g} s", end="")
    tip = recording.tip_positions[recording.has_tip]
    if len(tip):
        low, high = 1e3 * np.min(tip, axis=0), 1e3 * np.max(tip, axis=0)
        spans = (
            f"{x} {a:.4g} to {b:.4g}" for x, a, b in zip("xyz", low, high, strict=True) if a == a
        )
        print(f"; tip [mm]: {', '.join(spans)}", end="")
    print()
    for note in recording.notes:
        if note not in told:
            print(f"- {note}")
    if args.no_plot or not len(tip):
        return
    try:
        from calibration.report.log_plot import log_figure
    except ImportError:
        print("no picture without matplotlib: pip install 'softrod_jax[plots]'")
        return
    picture = Path(mapping).with_suffix("").with_suffix(".png")
    if picture.exists() and not args.force:
        print(f"{picture} is there already and stays as it is; --force draws it again")
        return
    log_figure(recording).savefig(picture, dpi=110)
    print(f"what is read is drawn in {picture}: does it look as the robot moved?")


def _next(scene_path, path, out, found) -> str:
    from calibration.data.loading import mapping_name

    scene = scene_path or "robot.toml"
    option = "" if out == mapping_name(path) else f" --mapping {_quoted(out)}"
    if found.tip is None:
        return f"softrod simulate {_quoted(scene)} --log {_quoted(path)}{option} --dt 0.01"
    return f"softrod calibrate {_quoted(scene)} {_quoted(path)}{option}"


def _quoted(path) -> str:
    import shlex

    return shlex.quote(str(path))
