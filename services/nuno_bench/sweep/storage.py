"""What a sweep is given and keeps: a scene with its files as plain data, and what is finished, line by line on disk."""

from __future__ import annotations

import hashlib
import json
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

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


def require_kept(paths: Sequence[Path]) -> None:
    """Raises BadInput where there is no sweep at all to go on with."""
    if not any(path.is_file() for path in paths):
        raise BadInput("there is no sweep to go on with", field="--resume", value=", ".join(map(str, paths)),
                       remedy="leave --resume out, or name the --out that it was started with")  # fmt: skip


class Kept:
    """JSON objects, one a line, under a first line that says what they belong to.

    lines  what an interrupted sweep had finished: empty unless it is resumed
    """

    def __init__(self, path: Path, identity: Mapping[str, Any], resume: bool) -> None:
        """Start anew, or go on where `resume` and there is a file.

        Raises BadInput where it is another sweep's, and where nothing can be written.
        """
        self.path, head, self.lines = path, dict(identity), list[dict[str, Any]]()
        if resume and path.is_file():
            for line in path.read_text(encoding="utf-8").split("\n"):
                # The last line may be half written; what it held is measured again.
                with suppress(ValueError):
                    self.lines.append(json.loads(line))
            before = self.lines.pop(0) if self.lines else {}
            if other := [name for name, value in head.items() if before.get(name) != value]:
                raise BadInput("what was kept belongs to another sweep", str(path), None, "--resume", ", ".join(other),
                               remedy="leave --resume out, or give another --out")  # fmt: skip
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text("".join(json.dumps(line) + "\n" for line in (head, *self.lines)), encoding="utf-8")
        except OSError as error:
            problem, remedy = f"cannot write there: {error.strerror}", "choose a folder that can be written"
            raise BadInput(problem, field="--out", value=str(path.parent), remedy=remedy) from None

    def add(self, data: Mapping[str, Any]) -> None:
        with self.path.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps(dict(data)) + "\n")
