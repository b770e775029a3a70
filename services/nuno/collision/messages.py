"""Bodies on the bus: geometry once, poses per frame."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from numpy.typing import NDArray

from nuno.bus.encodings import BadMessage, arrays_of, decode_arrays, encode_arrays
from nuno.plugin_contract.values import ContractError, check_field, check_layout, check_skins
from nuno_schemas.bodies import SKIN, DistanceField, Geometry, Poses, Skin

GEOMETRY_QUERY = "collision/ask/geometry"
POSES_QUERY = "collision/ask/poses"
LIVE_BODIES_QUERY = "collision/ask/told"
"""Names of the queries; the reply about live bodies is JSON with the joints and the key of each."""

NUMBERS = ("size", "tolerance", "band")
"""Numbers of a distance field, besides its arrays."""


def encode_geometry(geometry: Geometry, whole: bool = True) -> bytes:
    """Encode a geometry; one that is not `whole` is only for drawing, and has no distance fields."""
    arrays = arrays_of(geometry)
    text: dict[str, Any] = {"bodies": geometry.bodies, "frames": geometry.frames, "fields": []}
    for number, field in enumerate(geometry.fields if whole else ()):
        text["fields"].append(None if field is None else {name: getattr(field, name) for name in NUMBERS})
        if field is not None:
            arrays |= arrays_of(field, f"field{number}.")
    for number, skin in enumerate(geometry.skins):
        arrays |= arrays_of(skin, f"skin{number}.")
    return encode_arrays(arrays, text)


def decode_geometry(payload: bytes) -> Geometry:
    """Decode a geometry. Raises BadMessage."""
    arrays, text = decode_arrays(payload)
    try:
        plain = {name: values for name, values in arrays.items() if "." not in name}
        fields = tuple(
            None if numbers is None else DistanceField(**numbers, **_part(arrays, f"field{number}."))
            for number, numbers in enumerate(text.get("fields", ()))
        )
        skins = tuple(Skin(**_part(arrays, f"skin{i}.")) for i in range(int((plain["kind"] == SKIN).sum())))
        geometry = Geometry(tuple(text["bodies"]), tuple(text["frames"]), **plain, fields=fields, skins=skins)
        check_layout("", geometry)  # kernels do not check shapes and indices
        check_skins(geometry)
        for number, field in enumerate(geometry.fields):
            if field is not None:
                check_field(f"fields[{number}]", field)
        return geometry
    except (LookupError, TypeError, ValueError, OverflowError) as error:
        raise BadMessage(f"geometry without {error}") from None
    except ContractError as error:
        raise BadMessage(f"geometry of which {error}") from None


def _part(arrays: Mapping[str, NDArray[Any]], prefix: str) -> dict[str, Any]:
    """Return the arrays whose names have a prefix, without it."""
    return {name.removeprefix(prefix): values for name, values in arrays.items() if name.startswith(prefix)}


def encode_poses(poses: Poses, frame: int) -> bytes:
    return encode_arrays({"rotation": poses.rotation, "translation": poses.translation}, {"t": poses.t, "frame": frame})


def decode_poses(payload: bytes, frames: int | None = None) -> Poses:
    """Decode poses. Raises BadMessage, also for another number of `frames` if that is given."""
    arrays, text = decode_arrays(payload)
    try:
        poses = Poses(float(text["t"]), arrays["rotation"], arrays["translation"])
        check_layout("", poses, None if frames is None else {"f": frames})
        return poses
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise BadMessage(f"poses without {error}") from None
    except ContractError as error:
        raise BadMessage(f"poses of which {error}") from None
