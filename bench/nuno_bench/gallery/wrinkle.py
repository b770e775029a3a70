"""Shipped wrinkles: run, shown at the stages of the wrinkle paper's figures, and measured while they settle."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from nuno.collision.bodies import build_bodies
from nuno.exports.cloth import Pieces, read_frame
from nuno.exports.pictures import export_picture
from nuno.recording.reader import Recording
from nuno.recording.recorded import Frame
from nuno.scene import shipped
from nuno.scene.scene_file import Loaded
from nuno.simulation import cloth
from nuno.studio.draw import distance_to
from nuno_bench.gallery.kind import Difference, Gallery, read_picture, show_scene
from nuno_schemas.fabric import Bool, Float, Int, State
from nuno_schemas.pictures import Picture

NEAR = 0.06
"""Largest distance to a drawn line of the cloth that belongs to its wrinkle [m]."""
NAMES = ("hung-cloth-wrinkle", "bloom-skirt", "shirt-wrinkles")
"""Figures 4, 5 and 6, and 7 and 8."""
SIZE = (640, 480)
STAGES = ("as it was", "just drawn", "half way", "at the end")
HEIGHT, WIDTH, KEPT = "height of line {}, {} [mm]", "width of line {}, {} [mm]", "height kept by line {}"
SHIRT = "shirt-wrinkles"
"""Whose first line is on the wearer's left, whose second is on the right."""
DIFFERENCES = (
    Difference("the left wrinkle thins while it settles", (SHIRT, WIDTH.format(1, STAGES[1])),
               (SHIRT, WIDTH.format(1, STAGES[3]))),
    Difference("the right wrinkle fades", (SHIRT, HEIGHT.format(2, STAGES[1])), (SHIRT, HEIGHT.format(2, STAGES[3]))),
    Difference("the left one stays where the right one fades", (SHIRT, KEPT.format(1)), (SHIRT, KEPT.format(2))),
)  # fmt: skip


def scenes() -> dict[str, Path]:
    """Files of the shipped scenes with wrinkles by name."""
    known = shipped.scenes("")
    return {name: known[name] for name in NAMES if name in known}


def look(loaded: Loaded, recording: Recording, folder: Path) -> tuple[list[tuple[str, Picture]], dict[str, float]]:
    """Draw the stages of a recording, and measure its lines."""
    last = read_frame(recording)
    first = round(min((one["at"] for one in _operations(loaded)), default=0.0) * loaded.scene.frame_rate)
    before = read_frame(recording, first)
    found = {STAGES[0]: before} if len(before.x) < len(last.x) else {}
    drawn = first + len(found)
    half = (drawn + last.number) // 2
    frames = found | {STAGES[1]: read_frame(recording, drawn), STAGES[2]: read_frame(recording, half), STAGES[3]: last}
    pictures = [
        (f"{label}, {frame.t:.3g} s",
         read_picture(export_picture(recording, folder / "picture.png", frame.number, SIZE, "cloth")))
        for label, frame in frames.items()
    ]  # fmt: skip
    return pictures, _measure(recording, frames, loaded)


def _operations(loaded: Loaded) -> list[dict[str, Any]]:
    """Return the time and the fields of each wrinkle operation."""
    return [{"at": float(one.at), **one.config} for one in loaded.scene.operations if one.plugin == "wrinkle"]


def _raise(loaded: Loaded, before: Frame) -> Float:
    """(n, 3) [m] where the scene's lines raise the cloth, before any step: a frame later it has sunk already."""
    bodies = build_bodies(loaded) if loaded.scene.bodies else None
    poses = bodies.poses(0.0) if bodies else None
    fabric, _ = cloth.build_fabric(loaded, bodies.geometry if bodies else None, poses)
    state = State(before.x.astype(np.float64), np.zeros(before.x.shape), before.t)
    for operation in loaded.operations:
        changed = operation.plugin.apply(operation.config, fabric, state, None).changed
        fabric, state = changed.fabric, changed.state
    return np.asarray(state.x)


def _measure(recording: Recording, frames: dict[str, Frame], loaded: Loaded) -> dict[str, float]:
    """Of every line that is given by points and drawn while the scene goes on."""
    operations = _operations(loaded)
    lines = [np.array(line["points"], float) for one in operations for line in one["lines"] if "points" in line]
    if not lines or STAGES[0] not in frames:
        return {}
    fabric, drawn = recording.last_checkpoint().arrays, frames[STAGES[1]]
    crests = np.concatenate([fabric[f"fabric/crests/{i}"] for i in range(len(operations))], axis=1)
    places = {STAGES[1]: _raise(loaded, frames[STAGES[0]])} | {stage: frames[stage].x for stage in STAGES[2:]}
    ridges = Drawn(places[STAGES[1]], Pieces(recording).at(drawn.t)[0].faces, crests, lines)
    found: dict[str, float] = {}
    for stage, x in places.items():
        for i, ridge in enumerate(ridges.measure(x), 1):
            found |= {HEIGHT.format(i, stage): 1e3 * ridge.height, WIDTH.format(i, stage): 1e3 * ridge.width}
    for i in range(1, len(lines) + 1):
        found[KEPT.format(i)] = found[HEIGHT.format(i, STAGES[3])] / found[HEIGHT.format(i, STAGES[1])]
    return found


class Ridge(NamedTuple):
    """Means over a line's crests [m]: height over the chord across it, as a run's report has it, and width at half of
    that, along the chord. NaN where the line has no crest.
    """

    height: float
    width: float


class Drawn:
    """Crests of lines, and the triangles of each line's wrinkle.

    Heights are over the chord across a wrinkle, not over the cloth as it lay before: a line adds cloth, so that the
    feet of its wrinkle move as well, and what has sunk with its feet would count as faded.

    x (n, 3) [m] just drawn and its faces (f, 3); crests (5, c) vertices: on a line, to the left and to the right of it
    where nothing was smoothed, before and after on the line; lines (k, 3) [m] near x, each crest of the nearest.
    """

    def __init__(self, x: Float, faces: Int, crests: Int, lines: list[Float]) -> None:
        away = np.stack([distance_to(x, line) for line in lines], axis=1)
        nearest = away[crests[0]].argmin(axis=1)
        self._crests = [crests[:, nearest == i] for i in range(len(lines))]
        self._faces = [faces[(away[:, i] < NEAR)[faces].all(axis=1)] for i in range(len(lines))]

    def measure(self, x: Float) -> list[Ridge]:
        """Of every line, with the cloth at x (n, 3) [m]."""
        found = []
        for crests, faces in zip(self._crests, self._faces, strict=True):
            each = np.array([_across(x, faces, crest) for crest in crests.T]).reshape(-1, 2)
            found.append(Ridge(*each.mean(axis=0).tolist()) if len(each) else Ridge(float("nan"), float("nan")))
        return found


def _across(x: Float, faces: Int, crest: Int) -> tuple[float, float]:
    """Height of a crest over its chord, and how wide it is at half of that [m].

    The plane through chord and normal cuts the triangles in segments. What lies between the outermost points that reach
    half the height is the width, so that a wrinkle that has folded over is not counted twice.
    """
    top, one, other, before, after = x[crest]
    chord = (other - one) / np.linalg.norm(other - one)
    normal = np.cross(chord, after - before)
    normal /= np.linalg.norm(normal)
    normal *= np.sign((top - one) @ normal)
    height = float((top - one) @ normal)
    u, w, beside = (x - one) @ chord, (x - one) @ normal, (x - top) @ np.cross(chord, normal)
    start, end = _cut(faces, beside >= 0.0, np.stack([u, w], axis=1), beside)
    low, high = np.minimum(start[:, 1], end[:, 1]), np.maximum(start[:, 1], end[:, 1])
    half = 0.5 * height
    share = np.clip((half - start[:, 1]) / np.where(high > low, end[:, 1] - start[:, 1], 1.0), 0.0, 1.0)
    level = start[:, 0] + share * (end[:, 0] - start[:, 0])
    places = np.concatenate([start[start[:, 1] >= half, 0], end[end[:, 1] >= half, 0],
                             level[(low < half) & (high >= half)]])  # fmt: skip
    within = places[(places >= 0.0) & (places <= np.linalg.norm(other - one))]
    return height, float(np.ptp(within)) if len(within) else 0.0


def _cut(faces: Int, left: Bool, flat: Float, beside: Float) -> tuple[Float, Float]:
    """Ends (s, 2) of the segments in which the plane cuts triangles: `flat` (n, 2) where `beside` (n,) is 0."""
    cut = faces[left[faces].any(axis=1) & ~left[faces].all(axis=1)]
    # The corner that is alone on its side, then the other two.
    alone = np.argmax(left[cut] == (left[cut].sum(axis=1) == 1)[:, None], axis=1)
    rows = np.arange(len(cut))
    first, second, third = (cut[rows, (alone + k) % 3] for k in range(3))
    ends = []
    for far in (second, third):
        share = (beside[first] / (beside[first] - beside[far]))[:, None]
        ends.append(flat[first] + share * (flat[far] - flat[first]))
    return ends[0], ends[1]


KIND = Gallery(
    title="Wrinkles",
    lead="Ridges and valleys drawn on cloth, at the stages of the wrinkle paper's figures 4 to 8.",
    scenes=scenes,
    run_scene=partial(show_scene, look=look, whole=True),
    differences=DIFFERENCES,
    measures="Height: over the chord across the wrinkle, from cloth to cloth where nothing was smoothed. Width: along "
    "that chord, at half the height. Just drawn is as it is raised, before any step.",
)
