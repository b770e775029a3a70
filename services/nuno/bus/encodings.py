"""Encodings: `nuno.Arrays` (named arrays and a JSON text), foxglove.PointCloud and foxglove.CompressedImage.

Arrays travel as bytes with dtype and shape: as repeated numbers, 90,000 points take 400 times
as long to encode. The schema is built here instead of generated, so that no compiler is needed.
"""

from __future__ import annotations

import functools
import json
import math
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.message import DecodeError
from numpy.typing import NDArray

ARRAYS_SCHEMA = "nuno.Arrays"
_DTYPES = {"float64", "float32", "int64", "int32", "uint8", "int8", "bool"}


MOST_TEXT, MOST_FIELDS = 1 << 24, 10_000
"""Most bytes of JSON and fields of protobuf in a message: two bytes of more could decode to a hundred in memory."""


class BadMessage(ValueError):
    """A payload that violates the format of its topic."""


@functools.cache
def _file() -> descriptor_pb2.FileDescriptorProto:
    field = descriptor_pb2.FieldDescriptorProto
    file = descriptor_pb2.FileDescriptorProto(name="nuno/arrays.proto", package="nuno", syntax="proto3")
    array = file.message_type.add(name="Array")
    array.field.add(name="name", number=1, type=field.TYPE_STRING, label=field.LABEL_OPTIONAL)
    array.field.add(name="dtype", number=2, type=field.TYPE_STRING, label=field.LABEL_OPTIONAL)
    array.field.add(name="shape", number=3, type=field.TYPE_UINT32, label=field.LABEL_REPEATED)
    array.field.add(name="data", number=4, type=field.TYPE_BYTES, label=field.LABEL_OPTIONAL)
    arrays = file.message_type.add(name="Arrays")
    arrays.field.add(name="text", number=1, type=field.TYPE_STRING, label=field.LABEL_OPTIONAL)
    arrays.field.add(
        name="arrays", number=2, type=field.TYPE_MESSAGE, type_name=".nuno.Array", label=field.LABEL_REPEATED
    )
    return file


@functools.cache
def _arrays_class() -> Any:
    pool = descriptor_pool.DescriptorPool()
    pool.Add(_file())
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(ARRAYS_SCHEMA))


def arrays_schema() -> bytes:
    """Return the FileDescriptorSet that an MCAP reader needs to decode `nuno.Arrays`."""
    return descriptor_pb2.FileDescriptorSet(file=[_file()]).SerializeToString()


def arrays_of(part: Any, prefix: str = "") -> dict[str, NDArray[Any]]:
    """Return the array fields of a dataclass, by their names prefixed with `prefix`."""
    values_by_name = {attribute.name: getattr(part, attribute.name) for attribute in fields(part)}
    return {prefix + name: values for name, values in values_by_name.items() if isinstance(values, np.ndarray)}


def encode_arrays(arrays: Mapping[str, NDArray[Any]], text: Mapping[str, Any] | None = None) -> bytes:
    """Encode named arrays and a JSON-able mapping.

    Each array's bytes are written directly after a header: protobuf's own classes would copy a
    checkpoint three times, and take most of a run's memory.
    """
    parts: list[Any] = [_arrays_class()(text=json.dumps(dict(text or {}))).SerializeToString()]
    for name, values in arrays.items():
        message = _arrays_class()()
        message.arrays.add(name=name, dtype=str(values.dtype), shape=values.shape)
        head = message.arrays[0].SerializeToString()
        data = np.ascontiguousarray(values).reshape(-1).view(np.uint8).data
        field = field_header(4, len(data)) if len(data) else b""
        parts += [field_header(2, len(head) + len(field) + len(data)), head, field, data]
    return b"".join(parts)


def field_header(field: int, length: int) -> bytes:
    """Encode the key of a length-delimited protobuf field, and its length as a varint."""
    out = bytearray([field << 3 | 2])
    while length > 127:
        out.append(length & 127 | 128)
        length >>= 7
    out.append(length)
    return bytes(out)


def decode_arrays(payload: bytes) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """Decode named arrays (read-only) and the mapping. Raises BadMessage."""
    check_protobuf(payload, empty=True)
    try:
        message = _arrays_class().FromString(payload)
        if len(message.text) > MOST_TEXT:
            raise ValueError(f"a text of {len(message.text):,} letters")
        text = json.loads(message.text or "{}")
    except (DecodeError, ValueError, RecursionError) as error:
        raise BadMessage(f"not a nuno.Arrays message: {error}") from None
    if not isinstance(text, dict):
        raise BadMessage("the text of a nuno.Arrays message is not a mapping")
    arrays = {}
    for array in message.arrays:
        if array.dtype not in _DTYPES:
            raise BadMessage(f"array {array.name!r} has dtype {array.dtype!r}")
        dtype = np.dtype(array.dtype)
        if math.prod(array.shape) * dtype.itemsize != len(array.data):
            raise BadMessage(f"array {array.name!r} has {len(array.data)} bytes for shape {tuple(array.shape)}")
        try:
            arrays[array.name] = np.frombuffer(array.data, dtype).reshape(tuple(array.shape))
        except ValueError as error:  # more axes, or longer ones, than numpy can have
            raise BadMessage(f"array {array.name!r}: {error}") from None
        if dtype == np.bool_ and arrays[array.name].view(np.uint8).max(initial=0) > 1:
            raise BadMessage(f"array {array.name!r} of bool holds what is neither true nor false")
    return arrays, text


_FIXED = {1: 8, 5: 4}
"""Size in bytes of protobuf's wire types of fixed length."""


def check_protobuf(payload: bytes, empty: bool = False) -> None:
    """Raise BadMessage where fields do not fill a payload exactly, or are too many; nothing is copied. `empty` allows
    a payload without fields.
    """
    at = fields = 0
    while at < len(payload):
        fields += 1
        if fields > MOST_FIELDS:
            raise BadMessage(f"a message of more than {MOST_FIELDS:,} fields")
        key, at = _varint(payload, at)
        kind = key & 7
        if kind == 0:
            _, at = _varint(payload, at)
        elif kind == 2:
            length, at = _varint(payload, at)
            at += length
        elif kind in _FIXED:
            at += _FIXED[kind]
        else:
            raise BadMessage(f"no protobuf message: wire type {kind} at byte {at}")
    if at != len(payload) or not (payload or empty):
        raise BadMessage(f"no protobuf message: fields of {at} bytes in {len(payload)}")


def _varint(payload: bytes, at: int) -> tuple[int, int]:
    """Decode a varint of at most ten bytes; return it, and the position after it. Raises BadMessage."""
    value = 0
    for i, byte in enumerate(payload[at : at + 10]):
        value |= (byte & 127) << (7 * i)
        if byte < 128:
            return value, at + i + 1
    raise BadMessage(f"no protobuf message: cut at byte {len(payload)}")


POINTS_FIELD = 6
"""Number of a point cloud's field `data`, the last one."""


@functools.cache
def _point_cloud_fields() -> Any:
    from foxglove import messages

    kind = messages.PackedElementFieldNumericType.Float32
    return [messages.PackedElementField(name=axis, offset=4 * i, type=kind) for i, axis in enumerate("xyz")]


def origin_of(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the origin (3,) [m] of float32 positions x (n, 3) [m]: the first point, rounded to whole metres, so that
    float32 keeps its 24 bits for the cloth itself even far from the world's origin.
    """
    return np.round(x[0]) if len(x) and np.isfinite(x[0]).all() else np.zeros(3)


def encode_points(x: NDArray[np.float64], t: float) -> bytearray:
    """Encode positions (n, 3) [m] as foxglove.PointCloud, float32 about `origin_of` them, which is the cloud's pose.

    They are rounded where they lie in the message: its class would copy them twice.
    """
    from foxglove import messages

    origin = origin_of(x)
    seconds, nanos = divmod(round(t * 1e9), 10**9)
    pose = messages.Pose(
        position=messages.Vector3(x=float(origin[0]), y=float(origin[1]), z=float(origin[2])),
        orientation=messages.Quaternion(x=0.0, y=0.0, z=0.0, w=1.0),
    )
    stamp = messages.Timestamp(sec=seconds, nsec=nanos)
    cloud = messages.PointCloud(
        timestamp=stamp, frame_id="world", pose=pose, point_stride=12, fields=_point_cloud_fields(), data=b""
    )
    payload = bytearray(cloud.encode())
    if x.size:
        payload += field_header(POINTS_FIELD, 4 * x.size)
        start = len(payload)
        payload += bytes(4 * x.size)
        with np.errstate(over="ignore"):  # a diverging run's last frame may not fit; it is kept as inf
            points = np.frombuffer(payload, np.float32, offset=start).reshape(x.shape)
            np.subtract(x, origin, out=points, casting="same_kind")
    return payload


@functools.cache
def foxglove_class(schema: str) -> Any:
    """Return the class of a message such as `foxglove.PointCloud`."""
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(foxglove_schema(schema)).file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(schema))


def foxglove_schema(name: str) -> bytes:
    """Return the FileDescriptorSet of a schema such as `foxglove.PointCloud`."""
    from foxglove import messages

    return bytes(getattr(messages, name.removeprefix("foxglove.")).get_schema().data)


def encode_picture(png: bytes, t: float) -> bytes:
    """Encode a picture of time t [s] as foxglove.CompressedImage."""
    from foxglove import messages

    seconds, nanos = divmod(round(t * 1e9), 10**9)
    stamp = messages.Timestamp(sec=seconds, nsec=nanos)
    return bytes(messages.CompressedImage(timestamp=stamp, frame_id="camera", data=png, format="png").encode())


def decode_picture(payload: bytes) -> bytes:
    """Decode the PNG file of a foxglove.CompressedImage. Raises BadMessage."""
    try:
        message = foxglove_class("foxglove.CompressedImage").FromString(payload)
    except DecodeError as error:
        raise BadMessage(f"not a foxglove.CompressedImage message: {error}") from None
    if message.format != "png":
        raise BadMessage(f"a picture of format {message.format!r}; expected png")
    return bytes(message.data)


def decode_points(payload: bytes) -> NDArray[np.float64]:
    """Decode a foxglove.PointCloud of float32 as float64 positions (n, 3) [m]. Raises BadMessage."""
    try:
        message = foxglove_class("foxglove.PointCloud").FromString(payload)
    except DecodeError as error:
        raise BadMessage(f"not a foxglove.PointCloud message: {error}") from None
    if message.point_stride != 12 or len(message.data) % 12:
        raise BadMessage(f"point stride {message.point_stride}, {len(message.data)} bytes; expected 12 a point")
    p = message.pose.position
    x: NDArray[np.float64] = np.frombuffer(message.data, np.float32).reshape(-1, 3).astype(np.float64)
    x += np.array([p.x, p.y, p.z])
    return x
