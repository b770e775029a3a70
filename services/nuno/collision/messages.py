"""Bodies on the bus: geometry once, poses per frame."""

from __future__ import annotations

import numpy as np

from nuno.arrays import BadMessage, decode_arrays, encode_arrays
from nuno_schemas.bodies import Geometry, Poses

GEOMETRY_QUESTION = "collision/ask/geometry"
POSES_QUESTION = "collision/ask/poses"

_ARRAYS = ("kind", "frame", "body", "a", "b", "radius", "stiffness", "damping", "friction")
_MESHES = ("vertices", "faces", "owner")


def encode_geometry(geometry: Geometry) -> bytes:
    arrays = {name: getattr(geometry, name) for name in (*_ARRAYS, *_MESHES)}
    return encode_arrays(arrays, {"bodies": geometry.bodies, "frames": geometry.frames})


def decode_geometry(payload: bytes) -> Geometry:
    """Raises BadMessage."""
    arrays, text = decode_arrays(payload)
    try:
        return Geometry(tuple(text["bodies"]), tuple(text["frames"]), *(arrays[name] for name in (*_ARRAYS, *_MESHES)))
    except (KeyError, TypeError) as error:
        raise BadMessage(f"geometry without {error}") from None


def encode_poses(poses: Poses, frame: int) -> bytes:
    return encode_arrays({"rotation": poses.rotation, "translation": poses.translation}, {"t": poses.t, "frame": frame})


def decode_poses(payload: bytes) -> Poses:
    """Raises BadMessage."""
    arrays, text = decode_arrays(payload)
    try:
        rotation, translation, t = arrays["rotation"], arrays["translation"], float(text["t"])
    except (KeyError, TypeError, ValueError) as error:
        raise BadMessage(f"poses without {error}") from None
    if (
        rotation.shape != (len(translation), 4)
        or translation.shape[1:] != (3,)
        or not np.isfinite(rotation).all()
        or not np.isfinite(translation).all()
    ):
        raise BadMessage(f"poses of shapes {rotation.shape} and {translation.shape}, or not finite")
    return Poses(t, rotation, translation)
