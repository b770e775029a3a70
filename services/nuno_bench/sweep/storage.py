"""Input and storage of a sweep: a scene with its files as plain data, and finished results, line by line on disk."""

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
    """A scene's text, the user's overrides, and its files by their names in the scene.

    name  name of the scene in errors
    """

    name: str
    text: str
    overrides: tuple[str, ...]
    files: tuple[tuple[str, bytes], ...]

    @property
    def digest(self) -> str:
        """Digest of everything but the name, which identifies a sweep's results."""
        return hashlib.blake2b(repr((self.text, self.overrides, self.files)).encode(), digest_size=16).hexdigest()


def pack(path: Path, overrides: Sequence[str] = ()) -> Packed:
    """Read a scene and the files that it names. Raises BadInput for a scene that is refused."""
    return pack_loaded(scene_file.read(path, overrides))


def pack_loaded(loaded: Loaded) -> Packed:
    """Pack a loaded scene, and read the files that it names. Raises BadInput."""
    files = sorted(assets(loaded).items())
    for name, _ in files:
        if Path(name).is_absolute():
            remedy = "name it from the scene's folder on"
            raise BadInput("a file is named by a path of this machine alone", loaded.file, value=name, remedy=remedy)
    content = tuple((name, place.read_bytes()) for name, place in files)
    return Packed(loaded.file, loaded.path.read_text(encoding="utf-8-sig"), tuple(loaded.overrides), content)


@contextmanager
def unpacked(packed: Packed, overrides: Sequence[str] = ()) -> Iterator[Loaded]:
    """Yield the scene, with its files in a temporary folder. Raises BadInput.

    A name such as `../mesh.obj` was refused when the scene was packed: no file is written outside the folder.
    """
    with tempfile.TemporaryDirectory(prefix="nuno-") as folder:
        scene = Path(folder) / "scene.yaml"
        for name, content in (*packed.files, (scene.name, packed.text.encode())):
            (target := Path(folder) / name).parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(content)
        yield scene_file.read(scene, [*packed.overrides, *overrides], named=packed.name)


def require_kept(paths: Sequence[Path]) -> None:
    """Raise BadInput if there is no sweep to resume."""
    if not any(path.is_file() for path in paths):
        raise BadInput("there is no sweep to go on with", field="--resume", value=", ".join(map(str, paths)),
                       remedy="leave --resume out, or name the --out that it was started with")  # fmt: skip


class Kept:
    """JSON objects, one per line, after a first line that identifies their sweep.

    lines  finished results of an interrupted sweep: empty unless it is resumed
    """

    def __init__(self, path: Path, identity: Mapping[str, Any], resume: bool) -> None:
        """Start a new file, or continue an existing one if `resume`.

        Raises BadInput for the file of another sweep, and if nothing can be written.
        """
        self.path, head, self.lines = path, dict(identity), list[dict[str, Any]]()
        if resume and path.is_file():
            for line in path.read_text(encoding="utf-8").split("\n"):
                # The last line may be incomplete; its result is measured again.
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
