"""A scene with the files that it names, as plain data: what another process or machine needs to build it."""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from nuno.scene import scene_file
from nuno.scene.provenance import assets
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
        return hashlib.blake2b(repr((self.text, self.overrides, self.files)).encode(), digest_size=16).hexdigest()


def pack(path: Path, overrides: Sequence[str] = ()) -> Packed:
    """Read a scene and the files that it names. Raises BadInput for a scene that is refused."""
    return pack_loaded(scene_file.read(path, overrides))


def pack_loaded(loaded: Loaded) -> Packed:
    """A scene that has been read, and the files that it names. Raises BadInput."""
    files = sorted(assets(loaded).items())
    for name, _ in files:
        if Path(name).is_absolute():
            remedy = "name it from the scene's folder on"
            raise BadInput("a file is named by a path of this machine alone", loaded.file, value=name, remedy=remedy)
    content = tuple((name, place.read_bytes()) for name, place in files)
    return Packed(loaded.file, loaded.path.read_text(encoding="utf-8-sig"), tuple(loaded.overrides), content)


@contextmanager
def unpacked(packed: Packed, overrides: Sequence[str] = ()) -> Iterator[Loaded]:
    """The scene, its files in a folder of their own meanwhile. Raises BadInput.

    A name such as `../mesh.obj` was refused when the scene was packed: no file lands outside the folder.
    """
    with tempfile.TemporaryDirectory(prefix="nuno-") as folder:
        scene = Path(folder) / "scene.yaml"
        for name, content in (*packed.files, (scene.name, packed.text.encode())):
            (target := Path(folder) / name).parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(content)
        yield scene_file.read(scene, [*packed.overrides, *overrides], named=packed.name)
