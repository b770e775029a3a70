"""Bodies on the bus: geometry once, poses per frame."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno.wire.arrays import BadMessage, decode_arrays, encode_arrays
from nuno.wrong import Wrong, check_field
from nuno_schemas.bodies import Geometry, Poses
from nuno_schemas.field import DistanceField

GEOMETRY_QUESTION = "collision/ask/geometry"
POSES_QUESTION = "collision/ask/poses"

_ARRAYS = ("kind", "frame", "body", "a", "b", "radius", "stiffness", "damping", "friction")
_MESHES = ("vertices", "faces", "owner")


_FIELDS = ("low", "shape", "child", "corners")
_NUMBERS = ("size", "tolerance", "band")


def encode_geometry(geometry: Geometry, whole: bool = True) -> bytes:
    """Bytes of a geometry; one that is not `whole` is only to be drawn, and leaves the distance fields out."""
    arrays = {name: getattr(geometry, name) for name in (*_ARRAYS, *_MESHES)}
    text: dict[str, Any] = {"bodies": geometry.bodies, "frames": geometry.frames, "fields": []}
    for number, field in enumerate(geometry.fields if whole else ()):
        text["fields"].append(None if field is None else {name: getattr(field, name) for name in _NUMBERS})
        if field is not None:
            arrays |= {f"field{number}.{name}": getattr(field, name) for name in _FIELDS}
    return encode_arrays(arrays, text)


def decode_geometry(payload: bytes) -> Geometry:
    """Raises BadMessage."""
    arrays, text = decode_arrays(payload)
    try:
        fields = tuple(_field(arrays, number, text["fields"][number]) for number in range(len(text.get("fields", ()))))
        plain = {name: arrays[name] for name in (*_ARRAYS, *_MESHES)}
        geometry = Geometry(tuple(text["bodies"]), tuple(text["frames"]), **plain, fields=fields)
        _check(geometry)
        return geometry
    except (LookupError, TypeError, ValueError, OverflowError, Wrong) as error:
        raise BadMessage(f"geometry without {error}") from None


def _check(geometry: Geometry) -> None:
    """Raises BadMessage for arrays of other shapes than Geometry says, and indices of what is not there: kernels
    take both as they are.
    """
    g = geometry
    p, b, v, t = len(g.kind), len(g.bodies), len(g.vertices), len(g.faces)
    shapes = {"kind": (p,), "frame": (p,), "body": (p,), "a": (p, 3), "b": (p, 3), "radius": (p,), "stiffness": (b,),
              "damping": (b,), "friction": (b,), "vertices": (v, 3), "faces": (t, 3), "owner": (t,)}  # fmt: skip
    below = {"frame": len(g.frames), "body": b, "faces": v, "owner": p}
    for name, shape in shapes.items():
        values = getattr(g, name)
        if values.shape != shape or values.dtype.kind != ("i" if name in (*below, "kind") else "f"):
            raise BadMessage(f"geometry whose {name} is {values.dtype} {values.shape}, not {shape}")
        if name in below and values.size and not 0 <= values.min() <= values.max() < below[name]:
            raise BadMessage(f"geometry whose {name} goes from {values.min()} to {values.max()}, of {below[name]}")
    for number, field in enumerate(g.fields):
        if field is not None:
            check_field(f"fields[{number}]", field)


def _field(
    arrays: Mapping[str, NDArray[Any]], number: int, numbers: Mapping[str, float] | None
) -> DistanceField | None:
    if numbers is None:
        return None
    low, shape, child, corners = (arrays[f"field{number}.{name}"] for name in _FIELDS)
    size, tolerance, band = (float(numbers[name]) for name in _NUMBERS)
    return DistanceField(low, size, shape, tolerance, band, child, corners)


def encode_poses(poses: Poses, frame: int) -> bytes:
    return encode_arrays({"rotation": poses.rotation, "translation": poses.translation}, {"t": poses.t, "frame": frame})


def decode_poses(payload: bytes) -> Poses:
    """Raises BadMessage."""
    arrays, text = decode_arrays(payload)
    try:
        rotation, translation, t = arrays["rotation"], arrays["translation"], float(text["t"])
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise BadMessage(f"poses without {error}") from None
    if (
        rotation.shape != (len(translation), 4)
        or translation.shape[1:] != (3,)
        or not math.isfinite(t)
        or not np.isfinite(rotation).all()
        or not np.isfinite(translation).all()
    ):
        raise BadMessage(f"poses of shapes {rotation.shape} and {translation.shape}, or not finite")
    return Poses(t, rotation, translation)
