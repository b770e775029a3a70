"""A scene with the files that it names, as plain data: what another process or machine needs to build it."""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from nuno.recording.provenance import assets
from nuno.scene import scene_file
from nuno.scene.scene_file import Loaded
from nuno_schemas.errors import BadInput


@dataclass(frozen=True)
class Packed:
    """A scene's own text, the user's overrides, and its files by the names that it gives them.

    name  what errors call the scene
    """

    name: str
    text: str
    overrides: tuple[str, ...]
    files: tuple[tuple[str, bytes], ...]

    @property
    def digest(self) -> str:
        """Of everything but the name: what a sweep's results belong to."""
        hasher = hashlib.blake2b(digest_size=16)
        for part in (self.text.encode(), *(item.encode() for item in self.overrides)):
            hasher.update(b"%d:" % len(part) + part)
        for name, content in self.files:
            hasher.update(b"%d:%d:" % (len(name.encode()), len(content)) + name.encode() + content)
        return hasher.hexdigest()


def pack(path: Path, overrides: Sequence[str] = ()) -> Packed:
    """Read a scene and the files that it names. Raises BadInput for a scene that is refused."""
    loaded = scene_file.read(path, overrides)
    files = []
    for name, place in sorted(assets(loaded).items()):
        if Path(name).is_absolute():
            remedy = "name it from the scene's folder on"
            raise BadInput("a file is named by a path of this machine alone", str(path), value=name, remedy=remedy)
        files.append((name, place.read_bytes()))
    text = path.read_text(encoding="utf-8-sig")
    return Packed(str(path), text, tuple(overrides), tuple(files))


@contextmanager
def unpacked(packed: Packed, overrides: Sequence[str] = ()) -> Iterator[Loaded]:
    """The scene, its files in a folder of their own meanwhile. Raises BadInput.

    A name such as `../mesh.obj` was refused when the scene was packed: no file lands outside the folder.
    """
    with tempfile.TemporaryDirectory(prefix="nuno-") as folder:
        for name, content in packed.files:
            target = Path(folder) / name
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(content)
        scene = Path(folder) / "scene.yaml"
        scene.write_text(packed.text, encoding="utf-8")
        yield scene_file.read(scene, [*packed.overrides, *overrides], named=packed.name)
