"""Warnings of doubtful runs.

Warnings before the first step are in the plan, at the start and in the report; the others only in the report.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from nuno.scene.plausible import implausible_numbers
from nuno.scene.scene_file import Loaded
from nuno.scene.step import MOST_STEPS, ROUNDING, nearest_steps
from nuno.scene.validation_errors import EMPTY
from nuno_schemas.errors import BadInput

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
    return [*rounded_times(loaded), *rounded_steps(loaded), *empty, *implausible_numbers(loaded), *left_out(loaded)]


def left_out(loaded: Loaded) -> list[str]:
    """Return features of its weave that a dyed cloth lacks, by its plugin's `left_out(config, files)`."""
    if loaded.dye is None or not hasattr(loaded.dye.cloth.plugin, "left_out"):
        return []
    try:
        texts = loaded.dye.cloth.plugin.left_out(loaded.dye.cloth.config, loaded.files)
    except BadInput:  # raised again where the cloth is built
        return []
    return [f"dye.cloth: {text}" for text in texts]


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
            f"held vertices (pinned, attached, a pattern's waist) were kept back by cloth {held:,} times and may be "
            "off what carries them: do pins or bodies press cloth together?"
        )
    return warnings
