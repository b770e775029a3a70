"""Shipped wrinkles: run, shown at the stages of the wrinkle paper's figures, and measured while they settle."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from nuno.collision.bodies import outlines
from nuno.exports.cloth import Pieces, read_frame
from nuno.exports.pictures import export_picture
from nuno.python_api.fit import cut
from nuno.recording.reader import Recording
from nuno.recording.recorded import Frame
from nuno.scene import scene_file, shipped
from nuno.scene.scene_file import Loaded
from nuno.simulation import cloth
from nuno.simulation.run import Simulation
from nuno.studio.draw import distance_to
from nuno_bench.gallery.kind import Figure, Finding, Gallery, Measures, show_scene
from nuno_bench.report.page import Table
from nuno_schemas.colour import read_rgb
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Int, State
from nuno_schemas.pictures import Picture

NEAR = 0.06
"""Largest distance to a drawn line of the cloth that belongs to its wrinkle [m]."""
NAMES = ("hung-cloth-wrinkle", "bloom-skirt", "shirt-wrinkles")
"""Figures 4, 5 and 6, and 7 and 8."""
SIZE = (640, 480)
STAGES = ("as it was", "just drawn", "half way", "at the end")
STANDING, TURNING = "standing", "turning"
"""Stages of the skirt, before it is turned and at the end."""
BEFORE_TURN = 2.0
"""When the skirt begins to turn [s]."""
HEIGHT, WIDTH, KEPT = "height of line {}, {} [mm]", "width of line {}, {} [mm]", "height kept by line {}"
UNEVEN, HIGHEST, REACH = (
    "height round the circle, least over most, {}", "height of its highest tenth, {} [mm]",
    "largest speed at the end [mm/s]",
)  # fmt: skip
RIDGES, CUT, RADIUS, LOBES, DEPTH = (
    "ridges drawn", "mean radius of the hem, as cut [mm]", "mean radius of the hem, {} [mm]", "lobes of the hem, {}",
    "amplitude of its lobes, {} [mm]",
)  # fmt: skip
HUNG, BLOOM, SHIRT = NAMES
"""The shirt's first line is on the wearer's left, its second on the right."""
RESTING = 5.0
"""Largest speed of cloth at rest [mm/s]."""
WAVY = 5.0
"""Smallest amplitude of a hem's largest harmonic that is lobes [mm]: a cone's is about 0, and is of any number."""
THIN, GONE = 0.8, 0.25
"""Share of its width that a line has at most that has thinned, and of its height one that has disappeared."""


def scenes() -> dict[str, Path]:
    """Files of the shipped scenes with wrinkles by name."""
    known = shipped.scenes("")
    return {name: known[name] for name in NAMES if name in known}


def look(
    loaded: Loaded, recording: Recording, folder: Path, drawn: bool = True
) -> tuple[list[tuple[str, Picture]], dict[str, float]]:
    """Draw the stages of a recording, if asked, and measure its lines."""
    frames = _stages(loaded, recording)
    pictures = [
        (f"{label}, {frame.t:.3g} s",
         read_rgb(export_picture(recording, folder / "picture.png", frame.number, SIZE, "cloth")))
        for label, frame in frames.items() if drawn
    ]  # fmt: skip
    if loaded.scene.name == BLOOM:
        return pictures, _measure_skirt(recording, frames, loaded)
    if loaded.scene.name == HUNG:
        return pictures, _measure_circle(recording, frames, loaded)
    return pictures, _measure(recording, frames, loaded)


def _stages(loaded: Loaded, recording: Recording) -> dict[str, Frame]:
    """The frames that are shown, by their stages."""
    last = read_frame(recording)
    first = round(min((one["at"] for one in _operations(loaded)), default=0.0) * loaded.scene.frame_rate)
    before = read_frame(recording, first)
    if loaded.scene.name == BLOOM:
        standing = read_frame(recording, round(BEFORE_TURN * loaded.scene.frame_rate))
        return {STAGES[1]: before, STANDING: standing, TURNING: last}
    found = {STAGES[0]: before} if len(before.x) < len(last.x) else {}
    drawn = first + len(found)
    half = (drawn + last.number) // 2
    return found | {STAGES[1]: read_frame(recording, drawn), STAGES[2]: read_frame(recording, half), STAGES[3]: last}


def _operations(loaded: Loaded) -> list[dict[str, Any]]:
    """Return the time and the fields of each wrinkle operation."""
    return [{"at": float(one.at), **one.config} for one in loaded.scene.operations if one.plugin == "wrinkle"]


def _raise(loaded: Loaded, before: Frame) -> Float:
    """(n, 3) [m] where the scene's lines raise the cloth, before any step: a frame later it has sunk already."""
    fabric, _ = cloth.build_fabric(loaded)
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


class Hem(NamedTuple):
    """Mean radius over the angle [m], the number of lobes of the largest harmonic of radius over angle, and its
    amplitude [m].
    """

    radius: float
    lobes: int
    amplitude: float


def measure_hem(points: Float, centre: Float) -> Hem:
    """Return the shape of a closed line (p, 3) round an upright axis through `centre` (3,).

    The coefficients are c_n = (1 / 2 pi) integral of r e^(-i n theta) d theta along the line, r being constant on
    each of its parts: what the line runs back in a fold counts as negative.
    """
    across, deep = (points - centre)[:, [0, 2]].T
    radius, angle = np.hypot(across, deep), np.unwrap(np.arctan2(deep, across))
    turn = np.append(angle, angle[0] + 2.0 * np.pi * np.sign(angle[-1] - angle[0]))
    part, mean, waves = np.diff(turn), 0.5 * (radius + np.roll(radius, -1)), np.arange(1, len(points) // 2)
    share, middle = part / (turn[-1] - turn[0]), turn[:-1] + 0.5 * part
    smeared = np.sinc(np.outer(waves, part) / (2.0 * np.pi)) * np.exp(-1j * np.outer(waves, middle))
    size = 2.0 * np.abs(smeared @ (share * mean))
    return Hem(float(share @ mean), int(waves[size.argmax()]), float(size.max()))


def find_hem(faces: Int, x: Float) -> Int:
    """Return the vertices of the lowest border in order."""
    return np.array(min(outlines(faces), key=lambda loop: float(x[loop, 1].mean())), np.int32)


def _measure_skirt(recording: Recording, frames: dict[str, Frame], loaded: Loaded) -> dict[str, float]:
    """Of the hem, as cut and at each stage."""
    heights = [line["height"] for one in loaded.operations for line in one.config.model_dump()["lines"]]
    model = loaded.models[0].config.model_dump()
    faces, centre = Pieces(recording).at(0.0)[0].faces, np.array(model["centre"])
    found = {RIDGES: float(sum(height > 0.0 for height in heights)), CUT: 1e3 * model["hem_radius"]}
    for stage, frame in frames.items():
        hem = measure_hem(frame.x[find_hem(faces, frames[STAGES[1]].x)].astype(np.float64), centre)
        found |= {RADIUS.format(stage): 1e3 * hem.radius, LOBES.format(stage): float(hem.lobes),
                  DEPTH.format(stage): 1e3 * hem.amplitude}  # fmt: skip
    return found


def _measure_circle(recording: Recording, frames: dict[str, Frame], loaded: Loaded) -> dict[str, float]:
    """Of the closed line: how high and how unevenly high its crests stand as it is raised and at the end; and how
    still the cloth lies then.
    """
    x = _raise(loaded, frames[STAGES[0]])
    cloth_then = Pieces(recording).at(frames[STAGES[1]].t)[0]
    crests, faces, uv = recording.last_checkpoint().arrays["fabric/crests/0"], cloth_then.faces, cloth_then.uv
    assert uv is not None
    circle = np.array(next(line["texture"] for one in _operations(loaded) for line in one["lines"] if line["closed"]))
    away = np.linalg.norm(uv[crests[0]] - circle.mean(axis=0), axis=1) < 1.25 * np.ptp(circle, axis=0).max() / 2.0
    found: dict[str, float] = {}
    for stage, places in ((STAGES[1], x), (STAGES[3], frames[STAGES[3]].x.astype(np.float64))):
        heights = np.array([_across(places, faces, crest)[0] for crest in crests[:, away].T])
        low, high = np.percentile(heights, (10, 90))
        found |= {UNEVEN.format(stage): float(low / high), HIGHEST.format(stage): 1e3 * float(high)}
    last = frames[STAGES[3]]
    moved = np.linalg.norm(last.x - read_frame(recording, last.number - 1).x, axis=1).max()
    return found | {REACH: 1e3 * float(moved) * loaded.scene.frame_rate}


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
    start, end = cut(np.stack([w, beside, u], axis=1), faces, 0.0).ends.transpose(1, 0, 2)
    low, high = np.minimum(start[:, 1], end[:, 1]), np.maximum(start[:, 1], end[:, 1])
    half = 0.5 * height
    share = np.clip((half - start[:, 1]) / np.where(high > low, end[:, 1] - start[:, 1], 1.0), 0.0, 1.0)
    level = start[:, 0] + share * (end[:, 0] - start[:, 0])
    places = np.concatenate([start[start[:, 1] >= half, 0], end[end[:, 1] >= half, 0],
                             level[(low < half) & (high >= half)]])  # fmt: skip
    within = places[(places >= 0.0) & (places <= np.linalg.norm(other - one))]
    return height, float(np.ptp(within)) if len(within) else 0.0


def _judge_circle(measured: Measures) -> Finding:
    circle, stages = measured[HUNG], (STAGES[1], STAGES[3])
    (drawn, end), (high, left) = ([circle[name.format(stage)] for stage in stages] for name in (UNEVEN, HIGHEST))
    value = (
        f"drawn {drawn:.2f}, at rest {end:.2f}; its highest tenth {high:.1f} mm and {left:.1f} mm; "
        f"{circle[REACH]:.2g} mm/s at the end"
    )
    return Finding(value, end < 0.5 * drawn and left >= GONE * high and circle[REACH] < RESTING)


def _judge_skirt(measured: Measures) -> Finding:
    skirt = measured[BLOOM]
    radius, lobes, depth = (skirt[name.format(STANDING)] for name in (RADIUS, LOBES, DEPTH))
    value = (
        f"cut {skirt[CUT]:.1f} mm, raised {skirt[RADIUS.format(STAGES[1])]:.1f} mm, standing {radius:.1f} mm; "
        f"{lobes:.0f} lobes for {skirt[RIDGES]:.0f} ridges, {depth:.1f} mm"
    )
    return Finding(value, radius > skirt[CUT] and lobes == skirt[RIDGES] and depth >= WAVY)


def _judge_turning(measured: Measures) -> Finding:
    skirt = measured[BLOOM]
    before, after = skirt[RADIUS.format(STANDING)], skirt[RADIUS.format(TURNING)]
    lobes, depth = skirt[LOBES.format(TURNING)], skirt[DEPTH.format(TURNING)]
    value = f"standing {before:.1f} mm, turning {after:.1f} mm; {lobes:.0f} lobes, {depth:.1f} mm"
    return Finding(value, after > before and lobes == skirt[RIDGES] and depth >= WAVY)


def _judge_shirt(measured: Measures) -> Finding:
    shirt = measured[SHIRT]
    width = shirt[WIDTH.format(1, STAGES[3])] / shirt[WIDTH.format(1, STAGES[1])]
    left, right = (shirt[KEPT.format(i)] for i in (1, 2))
    value = f"left: {width:.2f} of its width, {left:.2f} of its height; right: {right:.2f} of its height"
    return Finding(value, width <= THIN and left > GONE >= right, ADDED)


ADDED = (
    "A line adds cloth, which is at rest as raised and cannot leave again; how wide its wrinkle is when drawn, two "
    "triangles and their neighbours, depends on the mesh. The table has other meshes, springs and cloths."
)
OWN, FABRIC = "operations.0", "objects.0.model.fabric"
LINES = range(20)
"""Of the skirt, ridges and valleys by turns."""
SKIRTS: Mapping[str, tuple[str, ...]] = {
    "not kept": (f"{OWN}.keep=false",),
    "limp, 30 uN m": (f"{FABRIC}.hinge=3.0e-5",),
    "twice as heavy": (f"{FABRIC}.density=0.24",),
    "3 passes of smoothing": (f"{OWN}.smoothing.passes=3",),
    "ridges as high as valleys are deep, 3 cm": tuple(f"{OWN}.lines.{i}.height={0.03 * (-1) ** i}" for i in LINES),
}
"""Variants of the skirt, and their overrides."""
SHIRTS: Mapping[str, tuple[str, ...]] = {
    "48 round": ("objects.0.model.around=48",),
    "80 round": ("objects.0.model.around=80",),
    "new springs: physical": (f"{OWN}.springs=physical",),
    "kept": (f"{OWN}.keep=true",),
    "no friction": ("bodies.0.friction=0",),
    "stiff, 400 uN m": (f"{FABRIC}.hinge=4.0e-4",),
    "soft, 6 N/m": (f"{FABRIC}.structural=6",),
    "a membrane, interlock": ("objects.0.model.fabric=interlock",),
}
"""Variants of the shirt, and their overrides."""


def sweep_skirt() -> Table:
    """The hem before the skirt is turned, of its variants."""
    rows = []
    for name, own in SKIRTS.items():
        simulation = Simulation.with_bodies(scene_file.read(scenes()[BLOOM], own))
        centre = np.array(simulation.loaded.models[0].config.model_dump()["centre"])
        hem = find_hem(simulation.fabric.faces, simulation.state.x)
        found = [measure_hem(simulation.state.x[hem], centre)]
        failed = ""
        while simulation.t < BEFORE_TURN - 1e-9 and not failed:
            report = simulation.step().report
            failed = "" if report.status == "ok" else f"failed: {report.message}"
        found.append(measure_hem(simulation.state.x[hem], centre))
        raised, standing = (f"{1e3 * one.radius:.1f} mm, {one.lobes} of {1e3 * one.amplitude:.1f} mm" for one in found)
        rows.append([name, raised, failed or standing])
    caption = "Mean radius of the hem, and the number and amplitude of its lobes."
    return Table(("variant", "as raised", f"after {BEFORE_TURN:g} s"), rows, caption, prose=True)


def sweep_shirt() -> Table:
    """What is left of both lines on variants of the shirt."""
    rows = []
    for name, own in SHIRTS.items():
        try:
            shown = show_scene(scenes()[SHIRT], partial(look, drawn=False), whole=True, overrides=own)
            if shown.failed:
                rows.append([name, f"failed: {shown.failed}", "no"])
                continue
            finding = _judge_shirt({SHIRT: shown.measured})
            rows.append([name, finding.value, "yes" if finding.holds else "no"])
        except BadInput as error:
            rows.append([name, f"refused: {error.problem}", "no"])
    return Table(("variant", "at the end", "as the paper says"), rows, "Shares of what was drawn.", prose=True)


FIGURES = (
    Figure(
        "4", "A wrinkle that cannot be in the real world, where a part of the cloth alone bulges in a circle, becomes "
        "a shape that can arise.",
        "height round the circle, its lowest tenth over its highest: at rest less than half of what it was when drawn; "
        f"its highest tenth keeps at least {GONE:g} of its height; at rest: no vertex faster than {RESTING:g} mm/s",
        (HUNG,), _judge_circle,
    ),
    Figure(
        "5", "A simple cone becomes a bloom skirt: its hem widens, and has wrinkles.",
        "mean radius of the hem before it is turned: larger than that of the cut; largest harmonic of its radius over "
        f"the angle: as many lobes as ridges were drawn, of at least {WAVY:g} mm",
        (BLOOM,), _judge_skirt, (STAGES[1], STANDING),
        "The paper prints neither weights nor constants, nor how high the lines are. Ridges are drawn further out than "
        "valleys in, to the hem itself; folds are kept, as the rest lengths of the paper's bending springs keep them.",
        sweep_skirt,
    ),
    Figure(
        "6", "Turned by an external force, the wrinkles spread.",
        f"mean radius of the hem: larger than standing; largest harmonic: still the ridges, of at least {WAVY:g} mm",
        (BLOOM,), _judge_turning, (TURNING,), "How fast it turns is not printed: here 0.86 times a second.",
    ),
    Figure(
        "7, 8", "Of two lines on a shirt, the left wrinkle thins while it settles, and the right one disappears.",
        f"left: at the end at most {THIN:g} of its width when drawn, and more than {GONE:g} of its height; right: at "
        f"most {GONE:g} of its height", (SHIRT,), _judge_shirt, sweep=sweep_shirt,
    ),
)  # fmt: skip

KIND = Gallery(
    title="Wrinkles",
    lead="Ridges and valleys drawn on cloth, at the stages of the wrinkle paper's figures 4 to 8.",
    scenes=scenes,
    run_scene=partial(show_scene, look=look, whole=True),
    figures=FIGURES,
    measures="Height: over the chord across the wrinkle, from cloth to cloth where nothing was smoothed. Width: along "
    "that chord, at half the height. Just drawn is as it is raised, before any step.",
)
