"""Files that a scene names, which must be inside its folder or a root of the user."""

from __future__ import annotations

import difflib
import os
import shlex
from dataclasses import dataclass, field
from pathlib import Path

from nuno.scene import yaml_lines
from nuno.scene.validation_errors import validated
from nuno_schemas.errors import BadInput
from nuno_schemas.written import Fields, Written


@dataclass
class SceneFiles:
    """Resolves names against the scene's folder, then the extra roots.

    `used` collects the resolved files by name, so that a recording can include them; `stamps` detect later changes of
    them.
    """

    folder: Path
    roots: tuple[Path, ...] = ()
    used: dict[str, Path] = field(default_factory=dict)
    stamps: dict[str, tuple[int, int]] = field(default_factory=dict)

    def resolve(self, name: str) -> Path:
        """Return the existing file `name`. Raises BadInput if it is missing or outside every root."""
        missing: list[Path] = []
        links: list[Path] = []
        allowed = ", ".join(str(root) for root in (self.folder, *self.roots))
        bases = [root.resolve() for root in (self.folder, *self.roots)]
        for base in bases:
            try:
                path = (base / name).resolve()
                found = path.is_file()
                stamp = stamp_of(path) if found else (0, 0)
            except (OSError, ValueError, RuntimeError):  # a link to itself, a NUL, a name too long
                raise BadInput("not the name of a file", value=name, remedy="check the name") from None
            if not any(path.is_relative_to(one) for one in bases):
                if found and Path(os.path.normpath(base / name)).is_relative_to(base):
                    links.append(path)
                continue
            if found:
                self.used[name] = path
                self.stamps.setdefault(name, stamp)
                return path
            missing.append(path)
        for path in links:
            problem = f"the file is a link that leaves the scene's folder, to {path}"
            remedy = f"put the file itself there, or name its folder with --root {shlex.quote(str(path.parent))}"
            raise BadInput(problem, value=name, limit=allowed, remedy=remedy)
        if missing:
            remedy = f"{near(missing[0])}check the name, or name its folder with --root DIR"
            raise BadInput("no such file", value=name, limit=f"looked in {allowed}", remedy=remedy)
        remedy = "put the file there, or name its folder with --root DIR"
        raise BadInput("the path leaves the scene's folder", value=name, limit=allowed, remedy=remedy)

    def read(self, name: str, kind: type[Fields]) -> Written[Fields]:
        """Read a YAML or JSON file into a model. Raises BadInput with the line of an invalid field."""
        path = self.resolve(name)
        text = read_text(path, "the file", "save it as YAML or JSON in UTF-8")
        if path.suffix.lower() == ".json":
            # JSON is YAML except for tabs, which it has only between values: in texts they are written as \\t.
            text = text.replace("\t", " ")
        data, lines = yaml_lines.parse(text, str(path))
        return Written(validated(kind, data, str(path), lines), str(path), lines)


def read_text(path: Path, what: str, remedy: str) -> str:
    """Read a text in UTF-8, without a byte order mark. Raises BadInput that names it as `what`."""
    try:
        return path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is not text in UTF-8"
        raise BadInput(f"{what} cannot be read: {reason}", str(path), remedy=remedy) from None


MARK = "\ufeff"
"""A byte order mark, which some editors write at the start of a file."""


def read_scene(path: Path) -> str:
    """Return the exact text of a scene's file, with line ends and byte order mark. Raises BadInput."""
    try:
        if (size := path.stat().st_size) > yaml_lines.MAX_BYTES:
            raise yaml_lines.too_large(str(path), size)
        return path.read_bytes().decode("utf-8")
    except UnicodeDecodeError:
        raise BadInput("not a text file", str(path), remedy="a scene is YAML in UTF-8") from None
    except OSError as error:
        raise BadInput(f"cannot be read: {error.strerror}", str(path)) from None


def stamp_of(path: Path) -> tuple[int, int]:
    """Return size [bytes] and modification time [ns] of a file. Raises OSError."""
    state = path.stat()
    return state.st_size, state.st_mtime_ns


def near(missing: Path) -> str:
    """Return a suggestion of a file with a similar name in the missing one's folder, "" if there is none."""
    try:
        names = [one.name for one in missing.parent.iterdir() if one.is_file()]
    except (OSError, ValueError):
        return ""
    close = difflib.get_close_matches(missing.name, names, n=1, cutoff=0.7)
    return f"did you mean {close[0]!r}? " if close else ""
