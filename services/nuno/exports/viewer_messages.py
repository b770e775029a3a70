"""Messages of a run for viewers of MCAP files: shapes, points, transforms, numbers, curves, log, pictures of dye."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from nuno.bus.encodings import BadMessage, decode_points, encode_picture
from nuno.collision.bodies import vertex_normals
from nuno.exports import well_known
from nuno.exports.cloth import as_png
from nuno.exports.meshes import Shape, Show
from nuno.exports.well_known import encode_shapes, encode_turns, foxglove_kind
from nuno.recording.mcap_file import Shown
from nuno_schemas import messages
from nuno_schemas.fabric import Float
from nuno_schemas.vectors import face_areas

MESHES, NUMBERS, CURVE_BYTES = 0.085, 0.03, 40
"""Shares of a recording's bytes that all of these messages may have where another mesh or picture is written, and that
numbers and curves may have, with about so many bytes for each point of a curve. So large meshes, and small scenes, have
them in some of the frames.
"""
PAUSE = 40.0
"""Wall time of a run for each second that these messages of a topic take [s]."""
GRAIN = 2.0**-14
"""Positions are rounded to this share of an object's extent, so that they take half of their bytes."""
DENSITY, FEWEST, MOST = 0.01, 500, 20_000
"""Points on bodies for each recorded position of a vertex, and limits of their number."""
LIGHT = np.array([0.38, 0.81, 0.45])
"""Direction of the light that shades points on bodies, since points have no shading of their own."""
R2 = 0.7548776662466927, 0.5698402909980532
"""Steps of a sequence of points without gaps or clusters (Roberts, 2018)."""
SCHEMAS = {
    topic.name: topic.schema + "Numbers"
    for topic in (messages.STATUS, messages.DYE_STATUS, messages.PENETRATION, messages.CONTACT)
}
"""Names of the schemas of numbers, by the topic that has them."""
CURVES = (
    "energy_kinetic", "energy_total", "stretch", "depth", "distance", "supplied_", "mobile_", "fixed_", "force_",
)  # fmt: skip
"""Begins of the names of the numbers that rerun draws as curves: each takes a part of its window."""


class ViewerMessages:
    """Makes messages for viewers of the messages of a run.

    show    which has taken each message before
    frames  of the run, as planned
    warn    is called with a text, once for each topic whose messages cannot be shown. None: they raise BadMessage, and
            each frame has all it can have, with the bits that it has
    """

    def __init__(self, show: Show, frames: float, warn: Callable[[str], object] | None = None) -> None:
        self._show, self._planned, self._warn = show, frames, warn
        self.names: dict[str, list[tuple[str, ...]]] = {}
        """Names of numbers by topic, in the order in which they came."""
        self._begun: set[str] = set()
        """Topics with messages that were shown."""
        self._failed: set[str] = set()
        self._left_out: tuple[str, bytes] | None = None
        """Topic and payload of the last frame, if it was not shown."""
        self._recorded = self._shown = self._numbers = self._taken = self._once = 0
        self._moved = b""
        self.pause, self._due = 0.0, dict[str, float]()
        """PAUSE in a running run, which these messages must not slow down; and when each topic is due again [s]."""

    def __call__(self, topic: str, at: int, payload: bytes, recorded: int, shown: int) -> Iterator[Shown]:
        """Yield the messages for viewers of one message at a time [ns], a `recording.writer.Repeat`."""
        self._recorded, self._shown = recorded, shown
        if topic in self._failed:
            return
        start, begun = time.perf_counter(), len(self._begun)
        try:
            self._show.take(topic, payload)
            yield from self.of(topic, at, payload)
        except BadMessage as error:
            self._failed.add(topic)
            if self._warn is not None:
                self._warn(f"viewers of MCAP files see no more of {error}")
        if len(self._begun) == begun:  # the first of a kind imports what makes it
            now = time.perf_counter()
            self._due[topic] = max(self._due.get(topic, 0.0), now) + self.pause * (now - start)

    def of(self, topic: str, at: int, payload: bytes) -> Iterator[Shown]:
        """Yield the messages for viewers of one message at a time [ns] that was taken. Raises BadMessage."""
        try:
            if topic == messages.STATE.name:
                yield from self._state(topic, at, payload)
            elif topic == messages.BODIES.name:
                yield from self._turns(at)
            elif topic == messages.CONCENTRATION.name:
                yield from self._dyed(topic, at, payload)
            elif topic in SCHEMAS:
                yield from self._status(topic, at, payload)
            elif topic.startswith(f"{messages.EVENT.name}/"):
                event = messages.Event.model_validate_json(payload)
                yield Shown("log", *foxglove_kind("Log"), well_known.encode_event(event, at))
                if event.kind == "end" and self._left_out is not None:  # the last frame is always shown
                    self._begun.discard(self._left_out[0])
                    yield from self.of(self._left_out[0], at, self._left_out[1])
        except (LookupError, ValueError, TypeError, AttributeError, ArithmeticError) as error:
            raise BadMessage(f"{topic}: {error}") from None

    def _first(self, kind: str) -> bool:
        """Return whether a message is the first of its kind."""
        first = kind not in self._begun
        self._begun.add(kind)
        return first

    def _wanted(self, topic: str, payload: bytes) -> bool:
        """Return whether a frame gets a mesh or picture: the first one, and others while there is room. The bodies'
        share of the room counts as the run goes on.
        """
        owed = self._once * max(0.0, 1.0 - self._taken / self._planned)
        room = self._shown - owed <= MESHES * self._recorded and time.perf_counter() >= self._due.get(topic, 0.0)
        wanted = self._first(topic) or room or self._warn is None
        self._left_out = None if wanted else (topic, payload)
        return wanted

    def _state(self, topic: str, at: int, payload: bytes) -> Iterator[Shown]:
        self._taken += 1
        if self._taken == 2:
            self._once = self._shown
        if not self._wanted(topic, payload):
            return
        x, show = decode_points(payload), self._show
        if len(x) < show.vertices or not np.isfinite(x).all():
            return
        first, shapes = show.origin is None, show.cloth(x)
        if first:
            yield Shown("scene/fixed", *foxglove_kind("FrameTransforms"), encode_turns(show.fixed(), at))
        if shapes:
            yield Shown("scene/cloth", *foxglove_kind("SceneUpdate"), encode_shapes(self._rounded(shapes), at))
        if skins := show.skins():
            yield Shown("scene/skins", *foxglove_kind("SceneUpdate"), encode_shapes(self._rounded(skins), at))

    def _rounded(self, shapes: list[tuple[str, Shape]]) -> list[tuple[str, Shape]]:
        """Return shapes with positions rounded to GRAIN of the extent of each, if these messages have little room."""
        if self._warn is None:
            return shapes
        grains = [GRAIN * 2.0 ** np.ceil(np.log2(np.ptp(shape.x, axis=0).max(initial=1e-9))) for _, shape in shapes]
        rows = zip(shapes, grains, strict=True)
        return [(frame, replace(shape, x=np.round(shape.x / grain) * grain)) for (frame, shape), grain in rows]

    def _turns(self, at: int) -> Iterator[Shown]:
        """Yield the bodies once, their meshes and points, and their transforms when they move."""
        show = self._show
        if self._first("scene/bodies"):
            if rigid := show.rigid():
                yield Shown("scene/bodies", *foxglove_kind("SceneUpdate"), encode_shapes(rigid, at))
            yield from self._points(show.parts(), at)
        assert show.poses is not None
        moved = show.poses.rotation.tobytes() + show.poses.translation.tobytes()
        if moved != self._moved or self._warn is None:
            self._moved = moved
            yield Shown("scene/frames", *foxglove_kind("FrameTransforms"), encode_turns(show.turns(), at))

    def _points(self, shapes: list[tuple[str, Shape]], at: int) -> Iterator[Shown]:
        """Yield points on each part of the bodies, for viewers without meshes."""
        areas = [face_areas(shape.x[shape.indices]).sum() for _, shape in shapes]
        number = min(max(DENSITY * self._planned * self._show.vertices, FEWEST), MOST)
        for (frame, shape), area in zip(shapes, areas, strict=True):
            x, shade = scatter(shape, 1 + int(number * area / sum(areas)))
            points = well_known.encode_points(x, shade[:, None] * shape.colours[:1], frame, at)
            yield Shown(f"scene/points/{shape.name}", *foxglove_kind("PointCloud"), points)

    def _dyed(self, topic: str, at: int, payload: bytes) -> Iterator[Shown]:
        painter = self._show.painter
        if painter is not None and painter.object is None and self._wanted(topic, payload):
            png = as_png(painter.draw(payload))
            yield Shown("scene/dye", *foxglove_kind("CompressedImage"), encode_picture(png, at / 1e9))

    def _status(self, topic: str, at: int, payload: bytes) -> Iterator[Shown]:
        room = self._numbers <= NUMBERS * self._recorded and time.perf_counter() >= self._due.get(topic, 0.0)
        if not (self._first(topic) or self._warn is None or room):
            return
        numbers = well_known.flatten(json.loads(payload))
        energies = [value for name, value in numbers.items() if name.startswith("energy_")]
        numbers |= {"energy_total": sum(energies)} if energies else {}
        names, known = tuple(numbers), self.names.setdefault(topic, [])
        if names not in known:
            known.append(names)
        schema = SCHEMAS[topic] + str(known.index(names) or "")
        message, text = well_known.numbers_class(schema, names)
        encoded = message(**numbers).SerializeToString()
        yield Shown(f"numbers/{topic}", schema, text, encoded)
        self._numbers += len(encoded)
        message, text = well_known.numbers_class(*well_known.CURVE)
        for name, value in numbers.items():
            if name.startswith(CURVES) and math.isfinite(value):
                payload = message(relative_humidity=value).SerializeToString()
                yield Shown(f"curves/{name}", well_known.CURVE[0], text, payload)
                self._numbers += CURVE_BYTES


def scatter(shape: Shape, number: int) -> tuple[Float, Float]:
    """Return points (number, 3) [m] evenly on a shape's triangles, and their brightness (number,) in [0, 1]."""
    a, b, c = np.take(shape.x, shape.indices.T, axis=0)
    area = face_areas(shape.x[shape.indices])
    share = (np.arange(number) + 0.5) / number * area.sum()
    of = np.minimum(np.searchsorted(np.cumsum(area), share), len(area) - 1)
    u, v = ((np.arange(number) * step % 1.0)[:, None] for step in R2)
    u, v = np.where(u + v > 1.0, 1.0 - u, u), np.where(u + v > 1.0, 1.0 - v, v)
    normal = vertex_normals(shape.x, shape.indices)[shape.indices[of, 0]]
    return a[of] + u * (b - a)[of] + v * (c - a)[of], 0.6 + 0.4 * np.clip(normal @ LIGHT, -1.0, 1.0)
