"""A run on a GPU as tables, in Markdown."""

from gpu_programs import KINDS, SETTINGS
from report import table


def render(rows: list[dict]) -> str:
    """All of a run in Markdown."""
    select = lambda part: [row for row in rows if row["part"] == part]
    parts = [row["device"] + "; " + row["name"] + "." for row in select("machine")]
    parts += [_batches(select("batch"), select("error"))]
    parts += [_pieces(select("piece"))]
    parts += [_loops(row) for row in select("loops")]
    for row in select("lockstep"):
        parts.append(
            f"Lockstep of {row['rods']} rods, {row['solves']} solves in time: "
            f"{row.get('evaluations')} evaluations, {row.get('factorisations')} factorisations, "
            f"{row.get('attempts')} attempts; a rod by itself needs "
            f"{row['evaluations_mean']:.0f} evaluations in the mean and {row['evaluations_most']} "
            f"at most: lockstep makes {row['lockstep_over_mean']:.2f} times as many."
        )
    limits = [f"{row['name']}: {row['value']:.3g} {row['unit']}" for row in select("device")]
    parts += ["The device: " + "; ".join(limits) + "."] if limits else []
    left_out = [f"{row['name']}: {row['problem']}" for row in select("skipped")]
    parts += ["Left out: " + "; ".join(left_out) + "."] if left_out else []
    return "\n\n".join(part for part in parts if part)


def _number(x, digits=3) -> str:
    if x is None:
        return ""
    return f"{x:.{digits}g}" if abs(x) < 1e5 else f"{x:.{digits - 1}e}"


def _batches(rows: list[dict], errors: list[dict]) -> str:
    if not rows:
        return ""
    off = {(row.get("name"), row.get("setting"), row.get("rods")): row for row in errors}
    motions = {
        (row["setting"], row["rods"]): row["seconds"]
        for row in rows
        if row["name"] == "motion" and "seconds" in row
    }
    lines = []
    order = {name: k for k, name in enumerate(["equilibrium", *KINDS])}
    for row in sorted(rows, key=lambda r: (order[r["name"]], r["setting"], r["rods"])):
        error = off.get((row["name"], row["setting"], row["rods"]), {}).get("largest")
        before = motions.get((row["setting"], row["rods"]))
        ratio = row["seconds"] / before if before and "seconds" in row else None
        setting = str(SETTINGS.get(row["setting"], ""))
        start = [row["name"], setting, str(row["rods"]), _number(row["compile"])]
        memory = _number(row["bytes_a_rod"] / 1e3)
        if "seconds" not in row:
            lines.append([*start, row["problem"], "", "", "", "", memory, "", ""])
            continue
        lines.append(
            [
                *start,
                _number(row["seconds"]),
                _number(row["rods_a_second"]),
                _number(row.get("rod_steps_a_second")),
                _number(row.get("rod_seconds_a_second")),
                f"{row['solved']:.2%}",
                memory,
                "" if row["name"] in ("motion", "equilibrium") else _number(ratio),
                _number(error, 2),
            ]
        )
    header = [
        "",
        "setting",
        "rods",
        "compile [s]",
        "a call [s]",
        "rods a second",
        "rod-steps a second",
        "rod-seconds a second",
        "solved",
        "memory a rod [kB]",
        "times the motion",
        "largest error [L]",
    ]
    return table(header, lines)


def _pieces(rows: list[dict]) -> str:
    lines, names = [], list(dict.fromkeys(row["name"] for row in rows))
    for name in names:
        by = {row["numbers"]: row for row in rows if row["name"] == name}
        row, single = by.get("float64"), by.get("float32")
        if row is None:
            continue
        taken, count = row["seconds"], row["operations"]
        lines.append(
            [
                name,
                _number(1e3 * taken),
                _number(1e6 * taken / row["rods"]),
                "" if count is None else _number(count / taken / 1e9),
                _number(row["bytes_moved"] / taken / 1e9),
                _number(row["kernels"], 4) + (" a pass" * row["loops_of_unknown_length"]),
                "" if single is None else _number(1e3 * single["seconds"]),
            ]
        )
    if not lines:
        return ""
    header = [
        f"piece, {rows[0]['rods']} rods",
        "float64 [ms]",
        "a rod [us]",
        "[Gop/s]",
        "[GB/s]",
        "kernels",
        "float32 [ms]",
    ]
    return table(header, lines)


def _loops(row: dict) -> str:
    lines = [
        [
            "· " * loop["depth"] + loop["name"],
            "?" if loop["passes"] is None else str(loop["passes"]),
            str(loop["kernels"]),
            str(loop["products"]),
            _number(loop["bytes"] / 1e6),
        ]
        for loop in row["loops"]
    ]
    header = [
        f"{row['name']}, {row['rods']} rods: loop",
        "passes",
        "kernels a pass",
        "of them products",
        "moved a pass [MB]",
    ]
    text = table(header, lines)
    if "kernels_a_step" in row:
        text += (
            f"\n\n{row['kernels_a_step']:.0f} kernels and {row['bytes_a_rod_step'] / 1e6:.3g} MB "
            f"a rod in a step. Launches predict {row['launching']:.3g} s, bytes "
            f"{row['moving']:.3g} s; measured {row['seconds']:.3g} s."
        )
    return text
