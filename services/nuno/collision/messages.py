"""Bodies on the bus: geometry once, poses per frame."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from numpy.typing import NDArray

from nuno.wire.arrays import BadMessage, decode_arrays, encode_arrays
from nuno.wrong import Wrong, check_field, check_layout, check_skins
from nuno_schemas.bodies import SKIN, Geometry, Poses
from nuno_schemas.field import DistanceField
from nuno_schemas.skin import Skin

GEOMETRY_QUESTION = "collision/ask/geometry"
POSES_QUESTION = "collision/ask/poses"
TOLD_QUESTION = "collision/ask/told"
"""What to ask for the bodies, and which of them are told where to be: as JSON, of each its joints and its key."""

_ARRAYS = ("kind", "frame", "body", "a", "b", "radius", "stiffness", "damping", "friction")
_MESHES = ("vertices", "faces", "owner")


_FIELDS = ("low", "shape", "child", "corners")
_NUMBERS = ("size", "tolerance", "band")
_SKINS = ("place", "joint", "weight")


def encode_geometry(geometry: Geometry, whole: bool = True) -> bytes:
    """Bytes of a geometry; one that is not `whole` is only to be drawn, and leaves the distance fields out."""
    arrays = {name: getattr(geometry, name) for name in (*_ARRAYS, *_MESHES)}
    text: dict[str, Any] = {"bodies": geometry.bodies, "frames": geometry.frames, "fields": []}
    for number, field in enumerate(geometry.fields if whole else ()):
        text["fields"].append(None if field is None else {name: getattr(field, name) for name in _NUMBERS})
        if field is not None:
            arrays |= {f"field{number}.{name}": getattr(field, name) for name in _FIELDS}
    for number, skin in enumerate(geometry.skins):
        arrays |= {f"skin{number}.{name}": getattr(skin, name) for name in _SKINS}
    return encode_arrays(arrays, text)


def decode_geometry(payload: bytes) -> Geometry:
    """Raises BadMessage."""
    arrays, text = decode_arrays(payload)
    try:
        fields = tuple(_field(arrays, number, text["fields"][number]) for number in range(len(text.get("fields", ()))))
        plain = {name: arrays[name] for name in (*_ARRAYS, *_MESHES)}
        number = int((plain["kind"] == SKIN).sum())
        skins = tuple(Skin(*(arrays[f"skin{i}.{name}"] for name in _SKINS)) for i in range(number))
        geometry = Geometry(tuple(text["bodies"]), tuple(text["frames"]), **plain, fields=fields, skins=skins)
        check_layout("", geometry)  # kernels take shapes and indices as they are
        check_skins(geometry)
        for number, field in enumerate(geometry.fields):
            if field is not None:
                check_field(f"fields[{number}]", field)
        return geometry
    except (LookupError, TypeError, ValueError, OverflowError) as error:
        raise BadMessage(f"geometry without {error}") from None
    except Wrong as error:
        raise BadMessage(f"geometry of which {error}") from None


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


def decode_poses(payload: bytes, frames: int | None = None) -> Poses:
    """Raises BadMessage, also for poses of another number of frames where that is given."""
    arrays, text = decode_arrays(payload)
    try:
        poses = Poses(float(text["t"]), arrays["rotation"], arrays["translation"])
        check_layout("", poses, None if frames is None else {"f": frames})
        return poses
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise BadMessage(f"poses without {error}") from None
    except Wrong as error:
        raise BadMessage(f"poses of which {error}") from None
