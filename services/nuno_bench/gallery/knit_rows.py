"""A knit's parameters and the numbers of its run, as rows of text."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from nuno.scene.scene_file import Loaded
from nuno_bench.gallery.knit_measures import Knitted, course_density
from nuno_bench.report.result import number

PARAMETER_HEADINGS = (
    "scene",
    "form",
    "wales",
    "courses",
    "yarns",
    "stretched by",
    "body",
    "between",
    "girth",
    "height",
)
NUMBER_HEADINGS = ("scene", "points", "links", "solver", "steps", "time [s]", "ended by", "deepest [um]", "stitches",
                   "course / rest", "pressure [Pa]")  # fmt: skip


def parameter_row(loaded: Loaded) -> list[str]:
    """Under PARAMETER_HEADINGS, of the scene's first object."""
    config = loaded.models[0].config.model_dump()
    over = config["over"] or {}
    shaped = " of each row" if over.get("of") == "own" else ""
    return [
        loaded.scene.name, config["form"], str(config["wales"]), str(config["courses"]),
        "; ".join(map(_yarn, loaded.data["objects"][0]["model"].get("yarns", config["yarns"]))),
        "" if over else " x ".join(f"{ratio:g}" for ratio in config["stretch"]), over.get("body", ""),
        _span(over.get("between")), f"{_span(over.get('girth'))}{shaped}", _span(over.get("height")),
    ]  # fmt: skip


def _yarn(choice: str | Mapping[str, Any]) -> str:
    """As the scene says it."""
    if isinstance(choice, str):
        return choice
    return " ".join([str(choice["name"]), *(f"{key} {value}" for key, value in choice.items() if key != "name")])


def _span(value: Any) -> str:
    """A number, or from where to where."""
    return " to ".join(map(str, value)) if isinstance(value, tuple) else "" if value is None else str(value)


def number_row(loaded: Loaded, report: Mapping[str, Any], knit: Knitted | None) -> list[str]:
    """Under NUMBER_HEADINGS, of a run's report, which is empty where there is none; how close stitches are is measured
    from where they lie.
    """
    if not report:
        return [loaded.scene.name, *[""] * (len(NUMBER_HEADINGS) - 1)]
    size, depth, courses = report["size"], report["penetration"], report["courses"]
    return [
        loaded.scene.name, f"{size['vertices']:,}", f"{size['springs']:,}", _solver(report),
        f"{_steps(loaded, report):,}", f"{report['wall_seconds']:.3g}", _end(loaded, report),
        "" if depth is None else number(1e6 * depth), "" if knit is None else _density(loaded, knit),
        f"{courses['mean']:.3g} ({courses['min']:.3g} to {courses['max']:.3g})" if courses else "",
        _pressure(dict(report["pressure"])),
    ]  # fmt: skip


def _solver(report: Mapping[str, Any]) -> str:
    dt = report["dt"]
    return str(report["solver"]) if dt is None else f"{report['solver']}, {dt:.4g} s"


def _steps(loaded: Loaded, report: Mapping[str, Any]) -> int:
    """That were taken; a solver of fixed steps does not count them, and takes none in idle frames."""
    frames = round(report["simulated_seconds"] * loaded.scene.frame_rate) - report["idle"]
    return int(report["totals"].get("steps") or frames * (report["steps_per_frame"] or 0))


def _end(loaded: Loaded, report: Mapping[str, Any]) -> str:
    """balance, rest, or frames, all of which were run; else the state that it failed in."""
    if report["state"] != "done":
        return f"failed, {report['state']}"
    return loaded.scene.until if report["rested"] or loaded.scene.until == "balance" else "frames"


def _density(loaded: Loaded, knit: Knitted) -> str:
    area, unit = (1e-4, "cm2") if loaded.scene.bodies else (1.0, "m2")
    density = area * course_density(knit)
    return f"{number(density.min())} to {number(density.max())} /{unit}"


def _pressure(found: dict[str, float]) -> str:
    """Of a report: mean, least and most, then by place."""
    if not found:
        return ""
    low, mean, high = (number(found.pop(which)) for which in ("min", "mean", "max"))
    return ", ".join([f"{mean} ({low} to {high})", *(f"{place} {number(value)}" for place, value in found.items())])
