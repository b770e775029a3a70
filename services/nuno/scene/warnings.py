"""Warnings of doubtful runs.

Warnings before the first step are in the plan, at the start and in the report; the others only in the report.
"""

from __future__ import annotations

import typing
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Any

from pydantic import BaseModel

from nuno.scene.scene_file import Loaded
from nuno.scene.step import MOST_STEPS, ROUNDING, nearest_steps
from nuno.scene.validation_errors import EMPTY
from nuno.scene.yaml_lines import Path, dotted
from nuno_schemas.errors import BadInput
from nuno_schemas.units import Plausible, to_si

MOST_STRETCH = 1.0
"""Largest plausible stretch: no woven or knitted thread is twice as long and still cloth."""
MOST_DEPTHS, SEEN_DEPTH = 5.0, 0.005
"""Cloth is too deep in bodies beyond this multiple of the depth of resting contact, if that is also
more than this [m]. The first alone would include every garment: a fold carries more than a vertex's own
weight (sheet on a sphere: 22 times at rest, 0.5 mm), and landing cloth sinks in for a moment (2 mm)."""
TOLERANCE = 1e-6
"""Relative tolerance of times in whole frames, for the rounding of decimal numbers."""


def scene_warnings(loaded: Loaded) -> list[str]:
    """Return warnings about a scene."""
    empty = [f"{field} is empty: {EMPTY}; null is none on purpose" for field in loaded.empty]
    return [
        *rounded_times(loaded),
        *rounded_steps(loaded),
        *empty,
        *implausible_numbers(loaded),
        *left_out(loaded),
        *doubts(loaded),
    ]


def left_out(loaded: Loaded) -> list[str]:
    """Return what cloth without a colour, and dyed cloth, lack of their files, by `left_out(config, files)` of their
    plugins.
    """
    objects = zip(loaded.models, loaded.scene.objects, strict=True)
    cloth = [model for model, spec in objects if spec.colour is None] + ([loaded.dye.cloth] if loaded.dye else [])
    texts = []
    for one in cloth:
        with suppress(BadInput):  # raised again where the cloth is built
            left = one.plugin.left_out(one.config, loaded.files) if hasattr(one.plugin, "left_out") else ()
            texts += [f"{one.field}: {text}" for text in left]
    return texts


def doubts(loaded: Loaded) -> list[str]:
    """Return doubts about cloth and motions, by `doubts(config, files)` of their plugins."""
    texts = list[str]()
    for one in (*loaded.models, *(motion for motion in loaded.motions if motion is not None)):
        with suppress(BadInput):  # raised again where they are built
            found = one.plugin.doubts(one.config, loaded.files) if hasattr(one.plugin, "doubts") else ()
            texts += [f"{one.field}.{text}" for text in found]
    return texts


def rounded_times(loaded: Loaded) -> list[str]:
    """Return warnings of times that are no whole number of frames, with the rounded ones."""
    scene, warnings = loaded.scene, list[str]()
    times = {
        "duration": scene.duration,
        "record.checkpoint_every": scene.record.checkpoint_every,
        "record.dye_every": scene.record.dye_every,
        "view.pictures": None if scene.view.pictures == "end" else scene.view.pictures,
    }
    for field, seconds in times.items():
        rounded = scene.in_frames(seconds) / scene.frame_rate if seconds is not None else 0.0
        if seconds is None or abs(rounded - seconds) <= TOLERANCE * seconds:
            continue
        frames = f"{seconds * scene.frame_rate:.4g} frames at {scene.frame_rate:.7g} Hz"
        outcome = "the run ends at" if field == "duration" else "taken as"
        warnings.append(f"{field}: {seconds:.7g} s is {frames}: {outcome} {rounded:.7g} s; change it, or frame_rate")
    return warnings


def rounded_steps(loaded: Loaded) -> list[str]:
    """Return warnings of steps of cloth and dye that do not divide the frame, with the used ones."""
    scene, warnings = loaded.scene, list[str]()
    solvers = [("solver.dt", scene.solver, 1.0)] if scene.moves else []
    solvers += [("dye.solver.dt", scene.dye.solver, scene.dye.speed)] if scene.dye is not None else []
    for field, solver, speed in solvers:
        frame = speed / scene.frame_rate
        if solver.dt == "auto" or solver.strict or not solver.dt <= frame <= MOST_STEPS * solver.dt:
            continue
        steps = nearest_steps(solver.dt, frame)
        if abs(frame / steps - solver.dt) > ROUNDING * solver.dt:
            asked, taken = f"{frame / solver.dt:.6g} steps of {solver.dt:.7g} s", f"{steps} of {frame / steps:.7g} s"
            warnings.append(f"{field}: a frame is {asked}: {taken} are taken; strict: true refuses that")
    return warnings


def result_warnings(report: Mapping[str, Any]) -> list[str]:
    """Return warnings about the result of a complete run."""
    warnings = []
    # Elastic yarns may stretch further than any woven cloth.
    if (report["stretch"] or 0.0) > MOST_STRETCH and not report.get("yarns"):
        warnings.append(f"threads were stretched by more than {MOST_STRETCH:.0%}: a stiffer fabric, or less load?")
    depth, expected = report["penetration"], report["rest_depth"]
    if depth is not None and expected is not None and depth > max(MOST_DEPTHS * expected, SEEN_DEPTH):
        often = f"{depth / expected:.0f} times as deep as" if expected else "deeper than"
        warnings.append(f"cloth lay in bodies {often} resting contact: from its start? stiffer contact, slower bodies?")
    counts = report["counts"]
    if still := counts.get("steps_without_motion"):
        warnings.append(
            f"all cloth stood still in {still:,} steps, more of it being pressed together than the lists of cloth "
            "contact hold: slower bodies, fewer layers, or shorter steps?"
        )
    if held := counts.get("held_cut_short"):
        warnings.append(
            f"held vertices (pinned, attached, a pattern's waist) were held back by cloth {held:,} times and may be "
            "off what carries them: do pins or bodies press cloth together?"
        )
    return warnings


# Warnings of bare numbers that are implausible in SI units: their unit was probably forgotten.

MOST = 10
"""Most warnings of a scene; the last one counts the others."""

Found = tuple[Path, float, Plausible]


def implausible_numbers(loaded: Loaded) -> list[str]:
    """Return warnings of bare numbers out of the ranges that their quantities declare (`nuno_schemas.units`)."""
    out = [_words("", *found) for found in _in_model(loaded.data, loaded.scene)]
    for chosen in loaded.chosen:
        out += [_words(f"{chosen.field}.", *found) for found in _in_model(chosen.given, chosen.config)]
    return out if len(out) <= MOST else [*out[:MOST], f"and {len(out) - MOST:,} more bare numbers are implausible"]


def implausible_fields(given: Mapping[str, Any], model: BaseModel, field: str) -> list[str]:
    """Return such warnings of the given fields of one model, each after `field`."""
    return [_words(field, *found) for found in _in_model(given, model)]


def with_doubts(loaded: Loaded, place: str, error: BadInput) -> BadInput:
    """Locate an error at a part of a scene, and add the doubt about a number there to its remedy."""
    error = loaded.at(place, error)
    doubt = next((text for text in implausible_numbers(loaded) if text.startswith(f"{place}.")), None)
    if doubt is None:
        return error
    return replace(error, remedy=f"{doubt} If not: {error.remedy}" if error.remedy else doubt)


def _words(field: str, place: Path, number: float, usual: Plausible) -> str:
    unit, low = usual.unit, f"{usual.low:g} to " if usual.low else "up to "
    source = f" ({usual.source})" if usual.source else ""
    others = [(f"{number:g} {other}", number * to_si(f"1 {other}", unit)) for other in usual.meant]
    meant = [f"{text}, which is {si:.4g} {unit}" for text, si in others if _is_plausible(si, usual)]
    question = f"; or was it {'; or '.join(meant)}?" if meant else ""
    usually = f"{low}{usual.high:g} {unit} is plausible{source}"
    return f"{field}{dotted(place)}: a bare {number:g} is {number:g} {unit}, where {usually}{question}"


def _is_plausible(number: float, usual: Plausible) -> bool:
    return number == 0.0 or usual.low <= abs(number) <= usual.high


def _in_model(given: Mapping[str, Any], model: BaseModel, place: Path = ()) -> Iterator[Found]:
    """Yield implausible numbers in the given fields of a model, with their paths."""
    for name, field in type(model).model_fields.items():
        if name in given:
            usual = _declared((field.annotation, *field.metadata))
            yield from _in_value(given[name], getattr(model, name, None), usual, (*place, name))


def _in_value(given: Any, value: Any, usual: Plausible | None, place: Path) -> Iterator[Found]:
    """Yield implausible numbers in a given value; the model's `value` selects one of several models."""
    if isinstance(given, Mapping):
        if isinstance(value, BaseModel):
            yield from _in_model(given, value, place)
        elif isinstance(value, Mapping):
            for key, one in given.items():
                yield from _in_value(one, value.get(key), usual, (*place, key))
    elif isinstance(given, list) and isinstance(value, list | tuple):
        for i, (one, its) in enumerate(zip(given, value, strict=False)):
            yield from _in_value(one, its, usual, (*place, i))
    elif usual is not None and (number := _bare(given)) is not None and not _is_plausible(number, usual):
        yield place, number, usual


def _bare(given: Any) -> float | None:
    """The number that is written without a unit."""
    try:
        return float(given) if isinstance(given, int | float | str) else None
    except ValueError:
        return None


def _declared(kinds: tuple[Any, ...]) -> Plausible | None:
    """Return the range of the first quantity among types and their metadata."""
    for kind in kinds:
        plausible = kind if isinstance(kind, Plausible) else _declared(typing.get_args(kind))
        if plausible is not None:
            return plausible
    return None
