"""Export of a recording as an MCAP file for Foxglove and Lichtblick: meshes, bodies, curves and log, with a layout."""

from __future__ import annotations

import json
import math
from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from foxglove import messages
from mcap.writer import CompressionType, Writer

from nuno.bus.encodings import foxglove_schema
from nuno.exports.camera import place_camera, read_view, z_up
from nuno.exports.meshes import CLOTH, ROOT, Shape, Show, Turn
from nuno.output_files import Progress, check_target, writing
from nuno.recording.mcap_file import CHUNK_BYTES
from nuno.recording.reader import Recording, opened
from nuno.recording.recorded import Recorded
from nuno.recording.writer import topic_of
from nuno_schemas.fabric import Float
from nuno_schemas.messages import BODIES, EVENT, PENETRATION, STATE, STATUS, Event
from nuno_schemas.pictures import Camera, Mesh

# The layout that shows an exported recording in Foxglove and Lichtblick.


class Topics(NamedTuple):
    """Topics of the 3-D panel: shapes and transforms."""

    cloth: str = "scene/cloth"
    bodies: str = "scene/bodies"
    skins: str = "scene/skins"
    frames: str = "scene/frames"
    fixed: str = "scene/fixed"


SCENE, EVENTS = Topics(), "log"
PANEL = (720, 720)
"""Panel size for the fitted camera: the whole scene is visible in any panel that is not higher than wide."""
BACKGROUND, GRID = "#e2e6ea", "#b3bac2"
CURVES = ("#e69f00", "#56b4e9", "#009e73", "#cc79a7", "#d55e00", "#0072b2", "#808080")
"""Distinguishable with the common colour-vision deficiencies (Okabe and Ito, 2008), and a grey."""


def arrange(
    recording: Recording, points: Sequence[Float], floor: float | None, frames: Sequence[str],
    topics: Collection[str], kinds: Mapping[str, Any],
) -> dict[str, Any]:  # fmt: skip
    """Return the layout for both: the scene on the left, on the right curves of energy and penetration, and the log.

    points  (n, 3) each [m]: points that must be in view, by the scene's view
    floor   height of the grid [m], None for the lowest point
    frames  names of all frames, whose axes are hidden
    topics  topics of the file; panels of other topics are left out
    kinds   JSON Schemas of some topics
    """
    cloud = z_up(np.concatenate(points))
    camera = place_camera(read_view(recording), [Mesh(cloud, np.zeros((0, 3), np.int32))], PANEL)
    height = float(cloud[:, 2].min()) if floor is None else floor
    shown = [topic for topic in (SCENE.cloth, SCENE.bodies, SCENE.skins) if topic in topics]
    panels: dict[str, Any] = {"3D!scene": _scene(camera, height, frames, shown)}
    if STATUS.name in topics:
        energy = kinds[STATUS.name]["properties"].get("energy", {}).get("properties", {})
        panels["Plot!energy"] = _plot("Energy [J]", {name: f"{STATUS.name}.energy.{name}" for name in energy})
    if PENETRATION.name in topics:
        depths = {"deepest": "depth", "mean of those inside": "mean"}
        curves = {label: f"{PENETRATION.name}.{field}" for label, field in depths.items()}
        panels["Plot!depth"] = _plot("Penetration [m]", curves)
    if EVENTS in topics:
        panels["RosOut!log"] = {"topicToRender": EVENTS, "minLogLevel": 1, "searchTerms": []}
    main, *side = panels
    # `target.MAGIC` relies on the first key: a layout saved by a viewer begins differently.
    return {
        "globalVariables": {"nuno": str(recording.scene.get("name", ""))},
        "configById": panels,
        "layout": _split("row", 68.0, main, _stack(side)) if side else main,
        "userNodes": {},
        "playbackConfig": {"speed": 1.0},
    }


def _stack(panels: Sequence[str]) -> Any:
    """Stack panels of equal height."""
    first, *others = panels
    return first if not others else _split("column", 100.0 / len(panels), first, _stack(others))


def _split(direction: str, share: float, first: Any, second: Any) -> dict[str, Any]:
    return {"direction": direction, "splitPercentage": share, "first": first, "second": second}


def _scene(camera: Camera, floor: float, frames: Sequence[str], topics: Sequence[str]) -> dict[str, Any]:
    return {
        "cameraState": camera_state(camera),
        "followTf": ROOT,
        "followMode": "follow-none",
        "scene": {"backgroundColor": BACKGROUND},
        "transforms": {f"frame:{name}": {"visible": False} for name in (ROOT, *frames)},
        "topics": {topic: {"visible": True} for topic in topics},
        "layers": {
            "grid": {
                "layerId": "foxglove.Grid", "instanceId": "grid", "label": "Grid", "visible": True, "order": 1,
                "frameId": ROOT, "frameLocked": True, "size": 4.0, "divisions": 8, "lineWidth": 1.0, "color": GRID,
                "position": [0.0, 0.0, floor], "rotation": [0.0, 0.0, 0.0],
            }
        },
    }  # fmt: skip


def camera_state(camera: Camera) -> dict[str, Any]:
    """Return the 3-D panel's state of a camera, z up.

    phi is the angle from the vertical, theta the angle about it: the panel's eye is at the target plus
    d (sin phi sin theta, -sin phi cos theta, cos phi), where theta is minus `thetaOffset`.
    """
    x, y, z = (camera.eye - camera.target).tolist()
    distance = math.hypot(x, y, z)
    return {
        "perspective": True,
        "distance": distance,
        "phi": math.degrees(math.acos(z / distance)),
        "thetaOffset": -math.degrees(math.atan2(x, -y)),
        "targetOffset": camera.target.tolist(),
        "target": [0.0, 0.0, 0.0],
        "targetOrientation": [0.0, 0.0, 0.0, 1.0],
        "fovy": math.degrees(camera.fov),
        "near": 0.01 * distance,
        "far": 100.0 * distance,
    }


def _plot(title: str, curves: Mapping[str, str]) -> dict[str, Any]:
    paths = [
        {"value": value, "label": label, "enabled": True, "timestampMethod": "receiveTime", "color": colour}
        for (label, value), colour in zip(curves.items(), CURVES * len(curves), strict=False)
    ]
    return {
        "foxglovePanelTitle": title, "lichtblickPanelTitle": title, "paths": paths, "xAxisVal": "timestamp",
        "isSynced": True, "showLegend": True, "legendDisplay": "top", "showPlotValuesInLegend": False,
        "showXAxisLabels": True, "showYAxisLabels": True, "sidebarDimension": 240,
    }  # fmt: skip


SUFFIX, LAYOUT = ".mcap", ".layout.json"
LIBRARY = "nuno export"
"""Library in the file's header, which distinguishes it from a recording."""
LOOKS = 16
"""Number of frames to which the camera is fitted."""
LINE = 2.0
"""Width of a net's links [pixels]."""
LEVELS = {"error": messages.LogLevel.Error, "warning": messages.LogLevel.Warning}
"""Log levels of events by kind; other kinds have Info."""


def export_foxglove(source: Recording | Path | str, path: Path, progress: Progress | None = None) -> list[Path]:
    """Write a whole recording, .mcap, and next to it its layout, .layout.json; return both paths.

    scene/cloth has a foxglove.SceneUpdate per frame, with one entity per object, by its name; scene/bodies the rigid
    bodies, once, in their frames, which scene/frames moves; scene/skins the bending bodies, each frame. Log times are
    times of the scene. Every JSON topic of the recording is copied under its name, and events are in `log`, too. Raises
    BadInput for another ending, a file that would be lost, a recording of dye alone, positions that are not finite,
    and damage.
    """
    layout_path = check_foxglove(path)
    with opened(source) as recording, writing(path, SUFFIX) as new, writing(layout_path, ".json") as layout:
        with new.open("wb") as stream:
            export = _Export(recording, stream)
            export.write(progress)
        layout.write_text(json.dumps(export.layout(), indent=1) + "\n", encoding="utf-8")
    return [path, layout_path]


def check_foxglove(path: Path) -> Path:
    """Return the path of the layout. Raises BadInput for another ending, and a file that would be lost."""
    check_target(path, SUFFIX)
    check_target(layout := path.with_suffix(LAYOUT), ".json")
    return layout


class _Export:
    """Writes a recording's messages, each at its own time, to a stream."""

    def __init__(self, recording: Recording, stream: BinaryIO) -> None:
        self.recording, self.show = recording, Show(recording)
        self.json = [name for name in recording.counts if (topic := topic_of(name)) and topic.encoding == "json"]
        self.kinds = describe_topics(recording, self.json)
        self.points: list[Float] = []
        """Points to which the camera is fitted, (n, 3) each [m]."""
        self._writer = Writer(stream, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._channels: dict[str, int] = {}

    def write(self, progress: Progress | None) -> None:
        """Write the whole recording. Raises BadInput."""
        self._writer.start(profile="", library=LIBRARY)
        start = next(self.recording.messages([STATE.name])).log_time
        self._put(SCENE.fixed, "foxglove.FrameTransforms", start, encode_turns(self.show.fixed, start))
        rigid = [entity(shape, frame, start) for frame, shape in self.show.bodies]
        if rigid:
            self._put(SCENE.bodies, "foxglove.SceneUpdate", start, messages.SceneUpdate(entities=rigid).encode())
        number, done, poses = self.recording.counts[STATE.name], 0, None
        looks = set(np.linspace(0, number - 1, LOOKS).round().astype(int).tolist())
        for message in self.recording.messages([STATE.name, BODIES.name, *self.json]):
            at = message.log_time
            if message.topic == STATE.name:
                self._put(SCENE.cloth, "foxglove.SceneUpdate", at, encode_shapes(self.show.cloth(message), at))
                if done in looks:
                    self.points.append(self.show.points(message, poses))
                done += 1
                if progress is not None:
                    progress(done, number)
            elif message.topic == BODIES.name:
                poses = self.show.poses(message)
                self._put(SCENE.frames, "foxglove.FrameTransforms", at, encode_turns(self.show.turns(poses), at))
                if skins := self.show.skins(poses):
                    self._put(SCENE.skins, "foxglove.SceneUpdate", at, encode_shapes(skins, at))
            else:
                self._pass_on(message)
        self._writer.finish()

    def layout(self) -> dict[str, Any]:
        """Return the layout of the written file."""
        frames = [turn.child for turn in self.show.fixed] + self.show.frames
        return arrange(self.recording, self.points, self.show.floor, frames, set(self._channels), self.kinds)

    def _pass_on(self, message: Recorded) -> None:
        """Copy a message of a JSON topic, and write an event to the log as well."""
        kind = topic_of(message.topic)
        schema = kind.schema if kind else message.topic
        self._put(message.topic, schema, message.log_time, message.payload, message.seq, self.kinds[message.topic])
        if message.topic.startswith(f"{EVENT.name}/"):
            self._put(EVENTS, "foxglove.Log", message.log_time, encode_event(self.recording, message))

    def _put(
        self, topic: str, schema: str, at: int, payload: bytes, number: int = 0, kind: dict[str, Any] | None = None
    ) -> None:
        """A message of a schema of foxglove's, or of JSON of a `kind`."""
        if topic not in self._channels:
            how = ("protobuf", foxglove_schema(schema)) if kind is None else ("jsonschema", json.dumps(kind).encode())
            known = self._writer.register_schema(schema, *how)
            self._channels[topic] = self._writer.register_channel(topic, "json" if kind else "protobuf", known)
        self._writer.add_message(self._channels[topic], log_time=at, publish_time=at, data=payload, sequence=number)


def describe_topics(recording: Recording, topics: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Return a JSON Schema of the content of each topic's messages.

    The recording's own schemas describe every possible message, with alternatives and mappings with any keys, which
    Lichtblick's reader (mcap-support/src/parseJsonSchema.ts, from Foxglove Studio) refuses.
    """
    contents: dict[str, list[Any]] = defaultdict(list)
    for message in recording.messages(topics):
        contents[message.topic].append(recording.json(message.payload))
    return {name: describe(contents[name]) or {"type": "object", "properties": {}} for name in topics}


def describe(values: Sequence[Any]) -> dict[str, Any] | None:
    """Return a JSON Schema of values: of objects with the properties of any of them, of arrays of one kind of item.
    None for values of several kinds, for no values, and for nested arrays.
    """
    values = [value for value in values if value is not None]
    kinds = {"number" if type(value) in (int, float) else type(value).__name__ for value in values}
    if len(kinds) != 1:
        return None
    kind = kinds.pop()
    if kind == "dict":
        names = dict.fromkeys(name for value in values for name in value)
        parts = {name: describe([value[name] for value in values if name in value]) for name in names}
        return {"type": "object", "properties": {name: part for name, part in parts.items() if part is not None}}
    if kind == "list":
        items = describe([item for value in values for item in value])
        return None if items is None or items["type"] == "array" else {"type": "array", "items": items}
    return {"type": {"bool": "boolean", "str": "string"}.get(kind, kind)}


def encode_shapes(shapes: Sequence[Shape], at: int) -> bytes:
    """Encode a foxglove.SceneUpdate of shapes in the frame CLOTH at a time [ns]: each replaces the last of its name."""
    encoded: bytes = messages.SceneUpdate(entities=[entity(shape, CLOTH, at) for shape in shapes]).encode()
    return encoded


def entity(shape: Shape, frame: str, at: int) -> messages.SceneEntity:
    """Return the entity of a shape that moves with a frame."""
    tints = [messages.Color(r=r, g=g, b=b, a=1.0) for r, g, b in shape.colours.tolist()]
    colour = {"color": tints[0]} if len(tints) == 1 else {"colors": tints}
    points = [messages.Point3(x=x, y=y, z=z) for x, y, z in shape.x.astype(np.float32).tolist()]
    fields = {"points": points, "indices": shape.indices.reshape(-1).tolist(), "pose": _pose(), **colour}
    if shape.indices.shape[1] == 3:
        parts = {"triangles": [messages.TriangleListPrimitive(**fields)]}
    else:
        kind = messages.LinePrimitiveLineType.LineList
        parts = {"lines": [messages.LinePrimitive(type=kind, thickness=LINE, scale_invariant=True, **fields)]}
    return messages.SceneEntity(timestamp=_stamp(at), frame_id=frame, id=shape.name, frame_locked=True, **parts)


def encode_turns(turns: Sequence[Turn], at: int) -> bytes:
    """Encode a foxglove.FrameTransforms at a time [ns]."""
    transforms = []
    for turn in turns:
        w, x, y, z = turn.rotation
        transforms.append(
            messages.FrameTransform(
                timestamp=_stamp(at), parent_frame_id=turn.parent, child_frame_id=turn.child,
                translation=messages.Vector3(**dict(zip("xyz", turn.translation, strict=True))),
                rotation=messages.Quaternion(x=x, y=y, z=z, w=w),
            )
        )  # fmt: skip
    encoded: bytes = messages.FrameTransforms(transforms=transforms).encode()
    return encoded


def encode_event(recording: Recording, message: Recorded) -> bytes:
    """Encode an event as a foxglove.Log. Raises BadInput for a message that is not an event."""
    event = Event.model_validate(recording.said(message))
    level = LEVELS.get(event.kind, messages.LogLevel.Info)
    encoded: bytes = messages.Log(
        timestamp=_stamp(message.log_time), level=level, message=event.message, name=event.service
    ).encode()
    return encoded


def _stamp(at: int) -> messages.Timestamp:
    seconds, nanos = divmod(at, 10**9)
    return messages.Timestamp(sec=seconds, nsec=nanos)


def _pose() -> messages.Pose:
    """Return the identity pose."""
    still = messages.Quaternion(x=0.0, y=0.0, z=0.0, w=1.0)
    return messages.Pose(position=messages.Vector3(x=0.0, y=0.0, z=0.0), orientation=still)
