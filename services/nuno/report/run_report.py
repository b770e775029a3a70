"""The report of a run: made from what its services say, and shown as rows of text."""

from __future__ import annotations

from typing import Any, TextIO

from nuno.formatting import counted, data_size, duration, factor, many
from nuno.runtime import outcome
from nuno.runtime.outcome import Outcome
from nuno.scene.scene_file import Loaded
from nuno.scene.warnings import result_warnings, scene_warnings
from nuno_schemas.messages import FRAMES

LOOKED_UP = ("steps", "parts", "energy", "counted", "friction", "solver", "idle")
"""Rows that only the whole report has."""
ENDS = (("min", "shortest"), ("max", "longest"))


def show_report(report: Report, out: TextIO, whole: bool) -> None:
    """Print a report, the whole or the brief one."""
    for name, text in lines(report) if whole else brief(report):
        print(row(name, text), file=out)


def row(name: str, text: object) -> str:
    """Format a heading and its text."""
    return f"{name:11} {text}"


def brief(report: Report) -> list[tuple[str, str]]:
    """Return the main rows of a report: speed, accuracy, distance from the step limit, features left out.

    Rows that a researcher looks up, as the shares of time and energy, counts and reasons, are only in the whole report.
    """
    hidden = {*LOOKED_UP, *(("balance",) if report.get("energy") else ())}
    rows, heading = list[tuple[str, str]](), ""
    for name, text in lines(report):
        heading = name or heading
        if heading not in (*hidden, "left out"):
            rows.append((name, text.partition("; ")[0] if name == "size" else text))
    left_out = ", ".join(text.partition(": ")[0] for text in report["left_out"])
    return [*rows, ("left out", f"{left_out}  (why, and more: --report)")] if left_out else rows


def lines(report: Report) -> list[tuple[str, str]]:
    """Return the report as rows (heading, text)."""
    rows = [("run", f"{report['run']}: {report['state']}{', at rest' if report['rested'] else ''}")]
    sizes = ", ".join(f"{n:,} {name}" for name, n in report["size"].items() if n)
    prepared = report["prepare_seconds"]
    if report["dt"] is None and not (sizes or report["frames"]["sent"]):
        if recorded := report["frames"]["recorded"]:
            text = f"{recorded:,} frames are recorded; the service that steps ended, or hung, in the one after them"
            return [*rows, ("time", text)]
        if wall := report["wall_seconds"]:
            return [*rows, ("time", f"its services ended {duration(wall)} after its start without an account of it")]
        return [*rows, ("time", f"ended while it was prepared, after {duration(prepared)}")]
    if report["began"]:
        text = f"at {report['began']:g} s; time, solver, idle frames, poses and frames count from there"
        rows.append(("resumed", f"{text}, all else from the recording's start"))
    rows += [("steered" if i == 0 else "", text) for i, text in enumerate(report.get("steered", ()))]
    rows.append(("size", f"{sizes or 'nothing to simulate'}; {report['threads']}"))
    simulated, wall = report["simulated_seconds"], report["wall_seconds"]
    speed = f"{duration(simulated)} simulated in {duration(wall)}: {factor(report['real_time_factor'])} real time"
    paused = f", paused for {report['paused_seconds']:.3g} s" if report["paused_seconds"] >= 0.005 else ""
    rows.append(("time", f"{speed} (prepared in {duration(prepared)}{paused})"))
    if clock := report.get("clock"):
        late = f"{clock['late']:,} of {clock['frames']:,} were late, by at most {clock['most']:.2g} s"
        rows.append(("clock", f"frames waited for it; {late if clock['late'] else 'none was late'}"))
    parts = {name: seconds for name, seconds in report["parts_seconds"].items() if seconds >= 0.0005}
    step_parts = {name: seconds for name, seconds in report.get("step_seconds", {}).items() if seconds >= 0.0005}
    if step_parts:
        rows.append(("steps", ", ".join(f"{name} {seconds:.3g} s" for name, seconds in step_parts.items())))
    rows.append(("parts", ", ".join(f"{name} {seconds:.3g} s" for name, seconds in parts.items())))
    rows.append(("step", _step(report)))
    if report["chosen"]:
        rows.append(("chosen for", report["chosen"]))
    if report["idle"]:
        rows.append(("idle", f"{report['idle']:,} frames in which nothing would have changed were not stepped"))
    work = {name: n for name, n in report["totals"].items() if name != "steps"}
    if work:
        rows.append(("solver", ", ".join(f"{n:,} {name.replace('_', ' ')}" for name, n in work.items())))
    rows += [*_physics(report), *(("warning", text) for text in [*report["warnings"], *result_warnings(report)])]
    frames = report["frames"]
    text = f"{frames['sent']} sent"
    if frames["recorded"] is not None:
        text += f", {frames['recorded']} recorded ({data_size(report['recorded_bytes'])})"
    if "viewer" in report["services"]:
        text += f", {frames['shown'] or 0} shown"
    rows.append(("frames", f"{text}, {report['missing']} missing, {report['refused']} refused"))
    if report.get("lost"):
        rows.append(("INCOMPLETE", f"the recording lacks {counted(report['lost'])}"))
    rows.append(("digest", str(report["digest"])))
    rows += [("left out" if i == 0 else "", text) for i, text in enumerate(report["left_out"])]
    return rows


def recorded_lines(report: Report) -> list[tuple[str, str]]:
    """Return the rows of a report from a file, which may have other fields, or other types."""
    try:
        return lines(report) if report else []
    except Exception as error:  # such a field may cause any error
        return [("report", f"damaged: {type(error).__name__}: {error}")]


def _step(report: Report) -> str:
    dt, limit = report["dt"], report["dt_limit"]
    if dt is None:
        return "none was taken"
    text = f"{report['solver']}, dt {dt * 1e3:.4g} ms, {report['steps_per_frame']} a frame"
    taken = report["totals"].get("steps", 0)
    if report.get("dye") and not report.get("dye_steps"):
        text += f", {taken:,} in all"
    if report["adaptive"] and taken:
        mean, own = report["simulated_seconds"] / taken, f"{report['solver']}, {taken:,} of its own choice"
        return f"{own}, {mean * 1e3:.3g} ms on average, at most {dt * 1e3:.4g} ms"
    if limit is None or limit == float("inf"):
        return f"{text}; nothing limits it"
    if limit <= 0.0:
        return f"{text}; never stable without damping"
    share = f"at {dt / limit:.0%} of it" if dt <= limit else f"{dt / limit:.3g} times ABOVE IT"
    return f"{text}; limit {limit * 1e3:.4g} ms, {share}"


def _follower_text(counts: Report) -> str:
    """Return the counts of poses for a body that is moved from outside, in words."""
    text = f"{counts['heard']:,} poses came, {counts['used']:,} were used, {counts['refused']:,} refused"
    text += f", {counts['left_out']:,} left out for newer ones" if counts["left_out"] else ""
    text += f", {counts['mixed']:,} by an earlier sender after another's" if counts.get("mixed") else ""
    behind = f", {counts['behind']:,} in which it was not yet at its goal" if counts["behind"] else ""
    return f"{text}; {counts['without']:,} frames without any{behind}; longest silence {counts['silence']:.2g} s"


def _dye(report: Report) -> list[tuple[str, str]]:
    """Return rows with the amounts of each dye in full cells, and their balance."""
    dye = report["dye"]
    rows: list[tuple[str, str]] = []
    if report["dye_steps"]:
        rows += [("dye step", _step(report["dye_steps"])), ("dye digest", report["dye_steps"]["digest"])]
    seconds, simulated = dye["seconds"], report["began"] + report["simulated_seconds"]
    if simulated and seconds != simulated:  # the simulated time is 0 if the simulation died
        rows.append(("dyeing", f"{duration(seconds)}, {seconds / simulated:g} times as fast as the scene"))
    first = next(iter(dye["supplied"]))
    for name, supplied in dye["supplied"].items():
        mobile, fixed = (_cells(dye[kind][name]) for kind in ("mobile", "fixed"))
        rows.append(
            (
                "" if name != first else "dye",
                f"{name}: {supplied:.6g} full cells supplied, {mobile} mobile, {fixed} fixed",
            )
        )
        rows += [("", f"  {text}") for text in _supply_lines(dye, name)]
        if slower := dye["weisz_zollinger"].get(name):
            rows.append(("", f"  D = D0 P T min({slower['cap']:g}, {slower['phi0']:g} / phi)"))
    late = [f"{name} begins at {duration(start)} of the dyeing, after the end" for name, start in dye["ahead"].items()]
    rows += [("not given" if i == 0 else "", text) for i, text in enumerate(late)]
    text = "not finite" if dye["balance"] is None else f"off by at most {dye['balance']:.2g} of what was supplied"
    return [*rows, ("balance", f"mobile + fixed - supplied: {text}")]


def _supply_lines(dye: Report, name: str) -> list[str]:
    """Return the amount of a dye from each supply, if there are several, and the rest in finite baths."""
    baths, account = dye["baths"], dye["given"][name]
    if len(account) == 1 and not baths.keys() & account.keys():
        return []
    left = {supply: f", {baths[supply]:.4g} of the bath is left" if supply in baths else "" for supply in account}
    return [f"{supply}: {_cells(amount)}{left[supply]}" for supply, amount in account.items()]


def _cells(amount: float | None) -> str:
    return "not finite" if amount is None else f"{amount:.6g}"


def _physics(report: Report) -> list[tuple[str, str]]:
    rows = []
    if report.get("dye") and not report["dye_steps"]:
        return _dye(report)
    if report["energy"]:
        first, last = report["energy"][0], report["energy"][-1]
        kinds = [kind for kind in last if first.get(kind) or last.get(kind)]
        text = ", ".join(f"{kind} {_joules(first.get(kind, 0.0))} -> {_joules(last[kind])}" for kind in kinds)
        rows.append(("energy", text or "0 J"))
        rows.append(("balance", _balance(first, last, report["left_out"], bool(report.get("steered")))))
    rows += [(operation["operation"], describe_start(operation["facts"])) for operation in report["arranged"]]
    stretch = report["stretch"]
    start_stretch = report.get("start_stretch") or 0.0
    since = f"; {start_stretch:.2%} at the start" if stretch is not None and start_stretch > stretch else ""
    if last := report.get("last_stretch"):
        place = ", ".join(f"{value:.3g}" for value in last["place"])
        since += f"; at the end {last['area']:.0%} of the area below {last['below']:.2%}, most at ({place}) m"
    rows.append(("stretch", _percent(stretch) + since))
    if rest := report["rest"]:
        beyond = f"; {rest['unsettled']:,} vertices are farther than that" if rest["unsettled"] else ""
        rows.append(("rest", f"every vertex within {rest['farthest']:.2g} of the mean tension{beyond}"))
    rows += _knit(report)
    if report["penetration"] is not None:
        text = f"at most {_millimetres(report['penetration'])}, {_millimetres(report['last_penetration'])} at the end"
        if report["rest_depth"] is not None:
            text += f"; resting contact is expected to sink m g / k = {_millimetres(report['rest_depth'])}"
            text += f" into a margin of {_millimetres(report['margin'])}" if report.get("margin") else ""
        rows.append(("penetration", text))
    if report.get("area") is not None:
        deep = f"at most {report['area'] * 1e4:.3g} cm^2 of cloth, {_millimetres(report['area_depth'])} deep"
        rows.append(("in bodies", deep if report["area"] else "no cloth, by points on every triangle"))
    rows += outcome.rows(report.get("cloth_contact"))
    rows += [("followed", f"{body}: {_follower_text(counts)}") for body, counts in report.get("followed", {}).items()]
    if report["slip_speed"]:
        text = f"what starts to slide is up to {_millimetres(report['slip_speed'])}/s faster than by Coulomb's law"
        rows.append(("friction", f"{text}, what turns round up to twice that"))
    warnings = {name: n for name, n in report["counts"].items() if n and name != "contacts"}
    if warnings:
        rows.append(("counted", ", ".join(f"{n} {name.replace('_', ' ')}" for name, n in warnings.items())))
    rows += _dye(report) if report.get("dye") else []
    return rows


def describe_start(facts: dict[str, float]) -> str:
    """Describe a change before the first frame: an operation, or a coarse start."""
    if "rested" in facts:
        rest = "came to rest" if facts["rested"] else "were let settle"
        took = f"in {facts['frames']:,.0f} frames ({facts['seconds']:.2g} s)"
        return f"{facts['vertices']:,.0f} vertices {rest} {took}, from which the cloth goes on"
    if not facts.get("crossings"):
        return "nothing crossed at the start"
    far = f"{_millimetres(facts['largest'])} at most, {_millimetres(facts['mean'])} on average of all"
    moved = f"{facts['vertices']:,.0f} vertices were moved in {facts['iterations']:,.0f} iterations, {far}"
    return f"{many(facts['crossings'], 'edge')} went through triangles at the start; {moved}"


def _knit(report: Report) -> list[tuple[str, str]]:
    """Return rows with the relative lengths of a knit's courses, and its pressure."""
    courses, pressure, rows = report["courses"], dict(report["pressure"]), []
    if courses:
        number, ends = len(courses["rest"]), [f"{courses[end]:.4g} (course {courses[which]})" for end, which in ENDS]
        rows.append(("courses", f"{number:,} of {courses['mean']:.4g} times their rest length, {' to '.join(ends)}"))
    if pressure:
        low, mean, high = (pressure.pop(name) for name in ("min", "mean", "max"))
        places = "".join(f", {name} {value:.4g} Pa" for name, value in pressure.items())
        rows.append(("pressure", f"{mean:.4g} Pa on average, {low:.4g} to {high:.4g} Pa{places}"))
    return rows


def _millimetres(depth: float) -> str:
    return f"{depth * 1e3:.3g} mm"


def _balance(first: dict[str, float | None], last: dict[str, float | None], left_out: list[str], steered: bool) -> str:
    start, end = (_total(energy) for energy in (first, last))
    if start is None or end is None:
        return f"{_joules(start)} -> {_joules(end)}"
    causes = {"damping": "", "wind and other forces": "the scene names none", "friction and moving bodies": "no bodies"}
    work = ", ".join(cause for cause, absent in causes.items() if not (absent and absent in " ".join(left_out)))
    changed = ", and by the changes during the run" if steered else ""
    return f"{_joules(start)} -> {_joules(end)}: {_joules(end - start)} by {work}{changed}"


STEERABLE = {
    "forces": "wind and other forces",
    "damping": "viscous damping",
    "gravity": "gravity",
    "wrinkle": "wrinkles",
}
"""Headings of what a run leaves out, by the start of the change that brings it in."""


def _left_out(outcome: Outcome, steered: list[str]) -> list[str]:
    """Return what the scene leaves out, but for what was brought in during the run."""
    brought = {heading for field, heading in STEERABLE.items() if any(text.startswith(field) for text in steered)}
    return [text for text in outcome.plan.left_out if text.partition(": ")[0] not in brought]


def _percent(stretch: float | None) -> str:
    if stretch is None:
        return "not finite"
    return f"at most {stretch:.2%}" if stretch < 100 else f"at most {stretch:.3g} times the rest length"


def _total(energy: dict[str, float | None]) -> float | None:
    values = [value for value in energy.values() if value is not None]
    return sum(values) if len(values) == len(energy) else None


def _joules(value: float | None) -> str:
    return "not finite" if value is None else f"{value:.4g} J"


# The report of a run: speed, accuracy, distance from the step limit, features left out.

Report = dict[str, Any]
SIZES, DYE_SIZES = ("vertices", "springs", "triangles of a membrane", "hinges"), ("cells",)

LEADER_DEFAULTS: dict[str, Any] = {
    "digest": "", "began": 0.0, "paused_seconds": 0.0, "step_seconds": {}, "totals": {}, "dt": None,
    "steps_per_frame": None, "idle": 0, "rested": False, "threads": "", "energy": [], "stretch": 0.0,
    "start_stretch": 0.0, "rest": {}, "clock": None, "counts": {}, "arranged": [], "changes": [], "steered": [],
    "yarns": {}, "courses": {}, "pressure": {}, "last_stretch": {},
}  # fmt: skip
"""Fields of the leading service's summary, and their values where it has none."""


def make_report(loaded: Loaded, outcome: Outcome) -> Report:
    """Return the counts of a run's services, in one JSON-able mapping."""
    summary, services = outcome.summary, outcome.services
    simulated = float(summary.get("simulated_seconds", 0.0))
    wall = float(summary.get("wall_seconds", outcome.seconds.get("run", 0.0)))
    parts = dict(summary.get("seconds", {}))
    solver = loaded.dye.solver if loaded.dye is not None and not loaded.scene.moves else loaded.integrator
    dyer = services.get("dye", {}).get("summary", {}) if loaded.scene.moves else summary
    if dyer and loaded.scene.moves:
        parts["dye"] = float(dyer.get("seconds", {}).get("steps", 0.0))
    return {
        "run": outcome.run,
        "scene": loaded.scene.name,
        "state": outcome.state,
        "error": outcome.error or summary.get("message", ""),
        "simulated_seconds": simulated,
        "wall_seconds": wall,
        "real_time_factor": simulated / wall if wall else 0.0,
        "prepare_seconds": outcome.seconds.get("prepare", 0.0),
        "parts_seconds": parts
        | {"bus": sum(float(s.get("bus_seconds", 0.0)) for s in services.values())}
        | {name: float(s["seconds"]) for name, s in services.items() if "seconds" in s},
        "solver": solver.name,
        "adaptive": loaded.scene.moves and solver.plugin.adaptive,
        "chosen": loaded.why,
        "warnings": [*scene_warnings(loaded), *summary.get("warnings", [])],
        "dt_limit": (summary.get("limit") or {}).get("dt"),
        "omega": (summary.get("limit") or {}).get("omega"),
        "size": {name: summary.get(name, 0) for name in (SIZES if loaded.scene.moves else ())}
        | {name: dyer.get(name, 0) for name in (() if loaded.dye is None else DYE_SIZES)},
        "penetration": services.get("collision", {}).get("deepest"),
        "cloth_contact": services.get("collision", {}).get("cloth_contact"),
        "followed": services.get("collision", {}).get("followed", {}),
        "last_penetration": services.get("collision", {}).get("last_depth"),
        "area": services.get("collision", {}).get("area"),
        "area_depth": services.get("collision", {}).get("area_depth"),
        **{name: (summary.get("facts") or {}).get(name) for name in ("rest_depth", "slip_speed", "margin")},
        # A dye that had to finish before its first frame has no amounts.
        "dye": dyer["dye"] if "supplied" in (dyer.get("dye") or {}) else None,
        "dye_steps": _dye_steps(loaded, dyer) if dyer and loaded.scene.moves else None,
        **_traffic(outcome),
        "services": list(outcome.plan.services),
        "left_out": _left_out(outcome, summary.get("steered", [])),
        **{name: summary.get(name, default) for name, default in LEADER_DEFAULTS.items()},
    }


def _traffic(outcome: Outcome) -> Report:
    """Return the numbers of frames and messages that were sent, recorded and lost."""
    services = outcome.services
    recorder, viewer = services.get("recorder", {}), services.get("viewer", {})
    return {
        "frames": {
            "sent": sum(_frames(services.get(name, {}).get("sent") or {}) for name in {outcome.plan.leader, "dye"}),
            "recorded": _frames(recorder["counts"]) if "counts" in recorder else None,
            "shown": viewer.get("shown"),
        },
        "missing": _count("missing", services),
        "lost": dict(recorder.get("missing") or {}),
        "refused": _count("refused", services),
        "recorded_bytes": recorder.get("bytes", 0),
    }


def _dye_steps(loaded: Loaded, dyer: Report) -> Report:
    """Return the step data of a garment's dye, separate from its cloth's."""
    names = ("dt", "steps_per_frame", "totals", "threads", "digest", "frame")
    solver = loaded.dye.solver.name if loaded.dye is not None else ""
    limit = (dyer.get("limit") or {}).get("dt")
    return {"solver": solver, "adaptive": False, "dt_limit": limit, "dye": True} | {n: dyer.get(n) for n in names}


def _frames(counts: dict[str, int]) -> int:
    return sum(counts.get(topic, 0) for topic in FRAMES)


def _count(name: str, services: dict[str, dict[str, Any]]) -> int:
    """Return the number of messages counted under a name; one counted by several services counts once."""
    most: dict[str, int] = {}
    for service in services.values():
        for topic, number in (service.get(name) or {}).items():
            most[topic] = max(most.get(topic, 0), number)
    return sum(most.values())
