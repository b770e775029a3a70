"""Input and storage of a sweep: a scene with its files as plain data, and finished results, line by line on disk."""

from __future__ import annotations

import fcntl
import hashlib
import json
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from nuno.scene import scene_file
from nuno.scene.provenance import assets
from nuno.scene.scene_file import Loaded
from nuno_schemas.errors import BadInput


@dataclass(frozen=True)
class PackedScene:
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


def pack(path: Path, overrides: Sequence[str] = ()) -> PackedScene:
    """Read a scene and the files that it names. Raises BadInput for a scene that is refused."""
    return pack_loaded(scene_file.read(path, overrides))


def pack_loaded(loaded: Loaded) -> PackedScene:
    """Pack a loaded scene, and read the files that it names. Raises BadInput."""
    files = sorted(assets(loaded).items())
    for name, _ in files:
        if Path(name).is_absolute():
            remedy = "name it from the scene's folder on"
            raise BadInput("a file is named by a path of this machine alone", loaded.file, value=name, remedy=remedy)
    content = tuple((name, place.read_bytes()) for name, place in files)
    return PackedScene(loaded.file, loaded.path.read_text(encoding="utf-8-sig"), tuple(loaded.overrides), content)


@contextmanager
def unpacked(packed: PackedScene, overrides: Sequence[str] = ()) -> Iterator[Loaded]:
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


class SweepFile(AbstractContextManager["SweepFile"]):
    """JSON objects, one per line, after a line that identifies their sweep; locked until `with` ends and adds FINISHED.

    lines  finished results of an interrupted sweep: empty unless it is resumed
    """

    FINISHED: ClassVar = {"finished": True}

    def __init__(self, path: Path, identity: Mapping[str, Any], resume: bool, say: Callable[[str], object]) -> None:
        """Start a new file, or continue an existing one if `resume`; call `say` where a finished sweep is replaced.

        Raises BadInput if another sweep writes there, kept rows would be lost or mixed, or nothing can be written.
        """
        self.path, self.lines = path, list[dict[str, Any]]()
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._stream = path.open("a+", encoding="utf-8", errors="replace")
            try:
                self._begin(dict(identity), resume, say)
            except BaseException:
                self._stream.close()  # a traceback that is kept would keep the lock, too
                raise
        except OSError as error:
            problem, remedy = f"cannot write there: {error.strerror}", "choose a folder that can be written"
            if isinstance(error, BlockingIOError):
                problem, remedy = "another sweep is writing there", "wait for its end, or give another --out"
            raise BadInput(problem, field="--out", value=str(path.parent), remedy=remedy) from None

    def _begin(self, head: dict[str, Any], resume: bool, say: Callable[[str], object]) -> None:
        fcntl.flock(self._stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        self._stream.seek(0)
        for line in self._stream.read().split("\n"):
            # The last line may be half written; what it held is measured again.
            with suppress(ValueError):
                self.lines.append(json.loads(line))
        before = self.lines.pop(0) if self.lines else {}
        other = ", ".join(name for name, value in head.items() if before.get(name) != value)
        finished, self.lines = self.FINISHED in self.lines, [line for line in self.lines if line != self.FINISHED]
        if (lost := not (resume or finished) and bool(self.lines)) or (resume and before and other):
            problem = "an interrupted sweep would be lost" if lost else "what was kept belongs to another sweep"
            remedy = f"{'' if other else 'continue it with --resume, '}give another --out, or remove {self.path}"
            raise BadInput(problem, str(self.path), field="--out" if lost else "--resume",
                           limit=f"it has another {other}" if other else None, remedy=remedy)  # fmt: skip
        if finished and not resume:
            say(f"the finished sweep in {self.path} is replaced")
            self.lines = []
        self._stream.truncate(0)
        for one in (head, *self.lines):
            self.add(one)

    def add(self, data: Mapping[str, Any]) -> None:
        self._stream.write(json.dumps(dict(data)) + "\n")
        self._stream.flush()

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        with self._stream:
            if kind is None:
                self.add(self.FINISHED)
