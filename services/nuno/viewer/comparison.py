"""Two or more recordings in one view: side by side or laid over each other, their curves in the same plots."""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr

from nuno.bus.encodings import BadMessage, decode_arrays
from nuno.exports.cloth import read_texture
from nuno.output_files import Progress, following
from nuno.recording.reader import Recording
from nuno.recording.recorded import Recorded
from nuno.viewer import layout
from nuno.viewer.bridge import Bridge
from nuno.viewer.fields import QUANTITIES, Scale, require_field
from nuno.viewer.file import RrdFile, measure_scales, recorded_painter, subject_of
from nuno.viewer.stream import APPLICATION, Subject
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Int
from nuno_schemas.messages import CONCENTRATION, FABRIC, STATE

GAP = 0.15
"""Space between scenes side by side, as a part of their width."""
SAME_TIME = 1e-6
"""Frames that are so near in time are compared [s]."""
DIFFERENCE = "difference"


@dataclass
class Compared:
    """One of the recordings: its name, its entities, and its cloth."""

    name: str
    recording: Recording
    bridge: Bridge
    faces: Int | None = None
    t: float = -np.inf
    """Time of its newest frame [s]."""

    def feed(self, message: Recorded) -> None:
        """Log one message. Raises BadMessage."""
        if message.topic == FABRIC.name:
            self.faces = np.asarray(decode_arrays(message.payload)[0]["faces"])
        if message.topic == STATE.name:
            self.t = message.t
        self.bridge.feed(message.topic, self.recording.mark(message)[0], message.t, message.payload)


def compare(
    recordings: Sequence[Recording],
    path: Path,
    over: bool = False,
    colour: str = "auto",
    progress: Progress | None = None,
) -> Path:
    """Write two or more recordings to a rerun file that shows them in one view, each below an entity of its name.

    over      whether they are laid over each other, in a colour each; else they stand side by side
    colour    what is seen first: cloth, a field, or auto, as the first scene's view says
    progress  is called with the messages done and in all

    Cloth of the same triangles as the first recording's also has its distance from that, in frames of the same time.
    Raises BadInput for recordings that cannot be compared, or are damaged.
    """
    check_comparable(recordings)
    scales = {name: Scale(quantity) for name, quantity in QUANTITIES.items()}
    names = names_of(recordings)
    with ExitStack() as stack:
        file = stack.enter_context(RrdFile(path, together(recordings)))
        compared = []
        for name, recording, tone in zip(names, recordings, itertools.cycle(layout.CURVES)):
            bridge = Bridge(
                file.recording, subject_of(recording).view, images=partial(read_texture, recording),
                painter=recorded_painter(recording, stack), colour=colour,
                entities=layout.Entities(file.recording, name, tone), scales=scales,
            )  # fmt: skip
            compared.append(Compared(name, recording, bridge))
        for recording in recordings:
            measure_scales(recording, scales)
        _log_all(compared, over, progress)
        for one in compared:
            one.bridge.flush()
        require_field(colour, {name for one in compared for name in one.bridge.window.fields})
        _arrange(file, compared, over)
        return file.finish()


def names_of(recordings: Sequence[Recording]) -> list[str]:
    """Return the names that distinguish recordings: those of their files, numbered where two are the same."""
    names = [recording.path.stem for recording in recordings]
    if len(set(names)) < len(names):
        return [f"{i + 1} {name}" for i, name in enumerate(names)]
    return names


def together(recordings: Sequence[Recording]) -> Subject:
    """Return what several recordings show together."""
    names = " and ".join(names_of(recordings))
    return Subject(run=names, layout=f"{APPLICATION} {names}")


def check_comparable(recordings: Sequence[Recording]) -> None:
    """Raise BadInput for recordings that are not of the same kind, or without a common time."""
    kinds = {_kind(recording) for recording in recordings}
    if None in kinds or len(kinds) > 1:
        lines = "; ".join(f"{r.path.name}: {_kind(r) or 'neither'}" for r in recordings)
        remedy = "compare cloth that moves with such cloth, and dye alone with dye alone"
        raise BadInput(f"the recordings do not show the same kind of thing: {lines}", remedy=remedy)
    start, end = max(r.span[0] for r in recordings), min(r.span[1] for r in recordings)
    if end < start:
        spans = "; ".join(f"{r.path.name} from {r.span[0]:g} to {r.span[1]:g} s" for r in recordings)
        raise BadInput(f"the recordings have no time in common: {spans}", remedy="compare runs of the same times")


def _kind(recording: Recording) -> str | None:
    """Return what a recording's frames are of, "moving cloth" or "dye"; None without frames."""
    kinds = {STATE.name: "moving cloth", CONCENTRATION.name: "dye"}
    return next((kind for topic, kind in kinds.items() if recording.counts.get(topic)), None)


def _log_all(compared: Sequence[Compared], over: bool, progress: Progress | None) -> None:
    """Log all messages of all recordings by their time, and distances of cloth from the first one's. Raises BadInput
    for a damaged recording.
    """

    def messages(index: int) -> Iterator[tuple[float, int, Recorded]]:
        for message in compared[index].recording.messages():
            yield message.t, index, message

    first, number = compared[0], sum(sum(one.recording.counts.values()) for one in compared)
    merged = heapq.merge(*(messages(i) for i in range(len(compared))), key=lambda item: item[:2])
    for _, index, message in following(merged, number, progress):
        one = compared[index]
        try:
            one.feed(message)
        except BadMessage as error:
            raise BadInput(f"a message cannot be read: {error}", str(one.recording.path)) from None
        if message.topic == FABRIC.name and over:
            _tint(one)
        if message.topic == STATE.name and index and one.t - first.t <= SAME_TIME:
            _log_difference(first, one)


def _tint(one: Compared) -> None:
    """Give all cloth of a recording the colour of its curves."""
    colour = rr.Mesh3D.from_fields(albedo_factor=[*(one.bridge.entities.colour or ()), 255])
    for cloth in one.bridge.cloths:
        if cloth.meshed:
            one.bridge.recording.log(cloth.path, colour, static=True)


def _log_difference(first: Compared, one: Compared) -> None:
    """Log the distance of each vertex from the first recording's, where both have the same triangles."""
    x, y = first.bridge.positions, one.bridge.positions
    if x is None or y is None or len(x) != len(y) or first.faces is None or one.faces is None:
        return
    if not np.array_equal(first.faces, one.faces):
        return
    bridge, apart = one.bridge, np.linalg.norm(y - x, axis=1)
    if not bridge.window.apart:
        bridge.window.apart = True
        bridge.entities.name_curves(DIFFERENCE, ["largest", "root mean square"])
        for cloth in bridge.cloths:
            if cloth.meshed:
                bridge.offer(cloth, DIFFERENCE)
    values = {"largest": 1e3 * float(apart.max()), "root mean square": 1e3 * float(np.sqrt((apart**2).mean()))}
    bridge.entities.log_values(DIFFERENCE, values)
    for cloth in bridge.cloths:
        if cloth.meshed:
            cloth.log_field(DIFFERENCE, apart[cloth.piece.start : cloth.piece.stop])


def _arrange(file: RrdFile, compared: Sequence[Compared], over: bool) -> None:
    """Place the scenes, and send the blueprint of all."""
    if _kind(compared[0].recording) == "dye":
        cloths = [cloth for one in compared if (cloth := one.bridge.dyed) is not None]
        dyes = list(dict.fromkeys(name for cloth in cloths for name in cloth.names))
        shape = max(cloth.painter.shape[0] for cloth in cloths), max(cloth.painter.shape[1] for cloth in cloths)
        duration, names = max(cloth.duration for cloth in cloths), [one.name for one in compared]
        blueprint = layout.arrange_dyed(dyes, shape, duration, "playing", names)
    else:
        blueprint = _arrange_cloth(file, compared, over)
    file.recording.send_blueprint(blueprint, make_active=True, make_default=True)


def _arrange_cloth(file: RrdFile, compared: Sequence[Compared], over: bool) -> Any:
    """Place scenes of moving cloth, and return the blueprint of all."""
    window, view = layout.Window(active=compared[0].bridge.window.active), compared[0].bridge.view
    right, stages, shift = np.array([np.cos(view.azimuth), 0.0, -np.sin(view.azimuth)]), list[Float](), 0.0
    for one in compared:
        own, stage = one.bridge.window, one.bridge.stage
        low, high = float((stage @ right).min()), float((stage @ right).max())
        offset = np.zeros(3) if over or one is compared[0] else (shift - low) * right
        shift = high + float(offset @ right) + GAP * (high - low)
        stages.append(stage + offset)
        place, above = one.bridge.entities.world(), 0.5 * (stage.min(axis=0) + stage.max(axis=0))
        above[1] = stage[:, 1].max() + 0.05 * (high - low)
        file.recording.log(place, rr.Transform3D(translation=offset), static=True, strict=True)
        if not over:
            label = rr.Points3D(
                [above], radii=0.0, labels=[one.name], show_labels=True, colors=[one.bridge.entities.colour]
            )
            file.recording.log(f"{place}/name", label, static=True, strict=True)
        window.runs.append(one.name)
        for part in ("bodies", "ground", "meets", "felt", "counted", "apart"):
            setattr(window, part, getattr(window, part) or getattr(own, part))
        window.dyes += [dye for dye in own.dyes if dye not in window.dyes]
        for name, paths in own.fields.items():
            window.fields.setdefault(name, {}).update(paths)
        if over and one is not compared[0]:
            window.hidden.append(one.bridge.entities.world("bodies"))
    if DIFFERENCE in window.fields and over:
        # Here the first recording's cloth would lie over the colours.
        window.fields[DIFFERENCE] |= {
            cloth.path: rr.blueprint.EntityBehavior(visible=False) for cloth in compared[0].bridge.cloths
        }
    eye = layout.fit_eye(np.concatenate(stages), view)
    return layout.arrange(eye, window, "playing")
