"""Files that a scene names, inside its folder or a root of the user; and the scenes that come with nuno."""

from __future__ import annotations

import difflib
import os
import shlex
from dataclasses import dataclass, field
from importlib.resources import files as package_files
from pathlib import Path

from pydantic import ValidationError

from nuno.scene import yaml_lines
from nuno.scene.validation_errors import explain
from nuno_schemas.errors import BadInput, nearest
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
        try:
            return Written(kind.model_validate(data), str(path), lines)
        except ValidationError as error:
            raise explain(error, data, (), str(path), lines, kind) from None


def read_text(path: Path, what: str, remedy: str) -> str:
    """Read a text in UTF-8, without a byte order mark. Raises BadInput that names it as `what`."""
    try:
        return path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is not text in UTF-8"
        raise BadInput(f"{what} cannot be read: {reason}", str(path), remedy=remedy) from None


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


# The scenes that come with the project, by name.

FOLDERS = ("contact", "dye", "extreme", "instruments", "knit", "sewn")
"""Folders of scenes; others lie in none."""


def scenes(*folders: str) -> dict[str, Path]:
    """Return scene files by name, `folder/name` in a folder; "" is the top folder; the default is all."""
    root = folder()
    paths = [path for name in folders or ("", *FOLDERS) for path in sorted((root / name).glob("*.yaml"))]
    return {path.relative_to(root).with_suffix("").as_posix(): path for path in paths}


def folder() -> Path:
    """Return the folder of the scenes, and of the files that they share."""
    source_folder = Path(__file__).resolve().parents[3] / "scenes"
    return source_folder if source_folder.is_dir() else Path(str(package_files("nuno"))) / "scenes"


def find(name: str) -> Path:
    """Return a scene file by path, or a shipped one by name. Raises BadInput."""
    path = Path(name)
    if path.is_file():
        return path
    shipped = scenes()
    if path.suffix == "" and name in shipped:
        return shipped[name]
    if path.suffix in (".yaml", ".yml") or path.exists():
        where = f"a file in {path.resolve().parent}"
        remedy = f"{near(path)}check the name; nuno scenes lists others"
        raise BadInput("no such scene file", value=name, limit=where, remedy=remedy)
    raise BadInput("no such scene", value=name, remedy=f"{nearest(name, shipped)}; or give the path of a YAML file")
