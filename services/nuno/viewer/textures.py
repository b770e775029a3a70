"""Textures of a run as a viewer finds them: among its own scene's files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path, PurePath

from nuno.wire.arrays import BadMessage, decode_arrays, encode_arrays


def with_own_textures(fabric: bytes, files: Mapping[str, Path]) -> bytes:
    """A fabric message that names the images of this viewer's scene.

    The simulation names an image by its path on its own disk, at the time of the run. Here the
    scene may lie elsewhere (another host), or in a recording whose files were unpacked. A path
    counts as the scene's file whose name it ends in; any other is not read: a message must not
    pick files here. What is not a fabric message stays as it is, for the views to refuse.
    """
    try:
        arrays, text = decode_arrays(fabric)
        for piece in text["objects"]:
            if piece.get("texture"):
                piece["texture"] = _own(str(piece["texture"]), files)
    except (BadMessage, KeyError, TypeError, AttributeError):
        return fabric
    return encode_arrays(arrays, text)


def _own(texture: str, files: Mapping[str, Path]) -> str:
    parts = PurePath(texture).parts
    for name, path in files.items():
        if parts[-len(PurePath(name).parts) :] == PurePath(name).parts:
            return str(path)
    return f"{parts[-1]} (not among the scene's files)"
