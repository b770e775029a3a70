"""Messages that viewers of MCAP files know: Foxglove's shapes, transforms and log, numbers, and curves."""

from __future__ import annotations

import functools
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from foxglove import messages
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

from nuno.bus.encodings import field_header, foxglove_class, foxglove_schema
from nuno.exports.meshes import Shape, Turn
from nuno_schemas.fabric import Float
from nuno_schemas.messages import Event

LINE = 2.0
"""Width of a net's links [pixels]."""
LEVELS = {"error": messages.LogLevel.Error, "warning": messages.LogLevel.Warning}
"""Log levels of events by kind; other kinds have Info."""


@functools.cache
def foxglove_kind(name: str) -> tuple[str, bytes]:
    """Return the type of a message such as `SceneUpdate`, and its description."""
    return f"foxglove.{name}", foxglove_schema(name)


def encode_shapes(shapes: Sequence[tuple[str, Shape]], at: int) -> bytes:
    """Encode a foxglove.SceneUpdate of shapes, each moving with a frame, at a time [ns]: each replaces the last of its
    name.

    Points, colours and indices are joined as arrays: objects of the library for each take fifty times as long.
    """
    return b"".join(_field("SceneUpdate", "entities", _entity(shape, frame, at)) for frame, shape in shapes)


def _entity(shape: Shape, frame: str, at: int) -> bytes:
    triangles = shape.indices.shape[1] == 3
    name, place = ("TriangleListPrimitive", "triangles") if triangles else ("LinePrimitive", "lines")
    primitive = foxglove_class(f"foxglove.{name}")()
    primitive.pose.orientation.w = 1.0
    if not triangles:
        primitive.type, primitive.thickness, primitive.scale_invariant = primitive.LINE_LIST, LINE, True
    tints = np.column_stack([shape.colours, np.ones(len(shape.colours))])
    if len(tints) == 1:
        primitive.color.r, primitive.color.g, primitive.color.b, primitive.color.a = tints[0].tolist()
    parts = [
        primitive.SerializeToString(),
        _rows(name, "points", shape.x.astype(np.float32).astype(np.float64)),
        _rows(name, "colors", tints) if len(tints) > 1 else b"",
        _field(name, "indices", shape.indices.astype("<u4").tobytes()),
    ]
    entity = foxglove_class("foxglove.SceneEntity")(frame_id=frame, id=shape.name, frame_locked=True)
    entity.timestamp.FromNanoseconds(at)
    encoded: bytes = entity.SerializeToString()
    return encoded + _field("SceneEntity", place, b"".join(parts))


def _number(message: str, field: str) -> int:
    return int(foxglove_class(f"foxglove.{message}").DESCRIPTOR.fields_by_name[field].number)


def _field(message: str, field: str, value: bytes) -> bytes:
    """Encode a field of bytes, of a message, or of packed numbers."""
    return field_header(_number(message, field), len(value)) + value


def _rows(message: str, field: str, values: Float) -> bytes:
    """Encode rows (n, k) of numbers as n messages, each of the doubles 1 to k."""
    columns = [part for k in range(values.shape[1]) for part in ((f"key{k}", "u1"), (f"{k}", "<f8"))]
    table = np.empty(len(values), np.dtype([("head", "u1", 2), *columns]))
    table["head"] = list(field_header(_number(message, field), 9 * values.shape[1]))
    for k in range(values.shape[1]):
        table[f"key{k}"], table[f"{k}"] = k + 1 << 3 | 1, values[:, k]
    return table.tobytes()


def encode_points(x: Float, colours: Float, frame: str, at: int) -> bytes:
    """Encode points (n, 3) [m] of a frame, with sRGB in [0, 1] (n, 3), at a time [ns] as foxglove.PointCloud."""
    table = np.empty(len(x), np.dtype([("x", "<f4", 3), ("colour", "u1", 4)]))
    table["x"], table["colour"][:, :3], table["colour"][:, 3] = x, np.rint(255.0 * colours), 255
    cloud = foxglove_class("foxglove.PointCloud")(frame_id=frame, point_stride=16, data=table.tobytes())
    cloud.timestamp.FromNanoseconds(at)
    cloud.pose.position.x, cloud.pose.orientation.w = 0.0, 1.0  # rerun's decoder wants both
    names, kind = ("x", "y", "z", "red", "green", "blue", "alpha"), messages.PackedElementFieldNumericType
    for i, name in enumerate(names):
        offset, number = (4 * i, kind.Float32) if i < 3 else (9 + i, kind.Uint8)
        cloud.fields.add(name=name, offset=offset, type=int(number))
    return bytes(cloud.SerializeToString())


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
    return bytes(messages.FrameTransforms(transforms=transforms).encode())


def encode_event(event: Event, at: int) -> bytes:
    """Encode an event as a foxglove.Log."""
    level = LEVELS.get(event.kind, messages.LogLevel.Info)
    return bytes(messages.Log(timestamp=_stamp(at), level=level, message=event.message, name=event.service).encode())


def _stamp(at: int) -> messages.Timestamp:
    seconds, nanos = divmod(at, 10**9)
    return messages.Timestamp(sec=seconds, nsec=nanos)


# Numbers of JSON messages as protobuf with a field for each, and single numbers as curves.


@functools.lru_cache(1024)
def _plain(name: str) -> str:
    """Return a valid name of a protobuf field."""
    return re.sub(r"\W", "_", name, flags=re.ASCII)


def flatten(value: Mapping[str, Any], prefix: str = "") -> dict[str, float]:
    """Return the numbers in a JSON message by their path, energy_kinetic; null is NaN. Of lists, those of three
    coordinates, and of objects with a body, which is part of the path.
    """
    found: dict[str, float] = {}
    for key, part in value.items():
        name = _plain(f"{prefix}{key}")
        if isinstance(part, dict):
            found |= flatten(part, f"{name}_")
        elif part is None or (isinstance(part, int | float) and not isinstance(part, bool)):
            found[name] = float("nan") if part is None else float(part)
        elif isinstance(part, list) and len(part) == 3 and all(isinstance(x, int | float) for x in part):
            found |= flatten(dict(zip("xyz", part, strict=True)), f"{name}_")
        elif isinstance(part, list):
            for item in part:
                if isinstance(item, dict) and "body" in item:
                    found |= flatten(item, f"{prefix}{item['body']}_")
    return found


CURVE = "sensor_msgs.msg.RelativeHumidity", ("relative_humidity",)
"""Type and field of the only message of a number without a unit that rerun draws as a curve."""


@functools.lru_cache(64)
def numbers_class(schema: str, names: tuple[str, ...]) -> tuple[Any, bytes]:
    """Return the class of a protobuf message such as `nuno.Status` with a double for each name, and its description."""
    package, _, short = schema.rpartition(".")
    file = descriptor_pb2.FileDescriptorProto(name=f"{short}.proto", package=package, syntax="proto3")
    message, field = file.message_type.add(name=short), descriptor_pb2.FieldDescriptorProto
    for number, name in enumerate(names, start=1):
        message.field.add(name=name, number=number, type=field.TYPE_DOUBLE, label=field.LABEL_OPTIONAL)
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    found = message_factory.GetMessageClass(pool.FindMessageTypeByName(schema))
    return found, descriptor_pb2.FileDescriptorSet(file=[file]).SerializeToString()
