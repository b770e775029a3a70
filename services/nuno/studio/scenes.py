"""Scenes that the page can open, and checks, changes, plans and saving of their text."""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from nuno.collision.bodies import build_bodies
from nuno.formatting import for_json
from nuno.output_files import replacing
from nuno.process import check_unprotected
from nuno.python_api.plan import Row, describe
from nuno.scene import edit, scene_file, shipped, yaml_lines
from nuno.scene.edit import put
from nuno.scene.files import read_scene
from nuno.scene.override import item_at
from nuno.scene.scene_file import Loaded
from nuno.scene.yaml_lines import dotted
from nuno.simulation.cloth import drawn_over, frame_of, no_body
from nuno.studio import server
from nuno_schemas.errors import BadInput, nearest
from nuno_schemas.fabric import Binding

# Missing files and bodies are found without building anything, with the errors of the code that would build them.

FILES = ("file", "texture")
"""Fields that name a file."""


def check_named(loaded: Loaded) -> None:
    """Raise BadInput for a missing file, and for cloth on a missing body."""
    for chosen in loaded.chosen:
        for place, text in yaml_lines.walk(chosen.config.model_dump()):
            field = next((part for part in reversed(place) if isinstance(part, str)), "")
            if isinstance(text, str) and field in FILES:
                with loaded.errors_at(chosen.field):
                    loaded.files.resolve(text)
    bodies = [body.name for body in loaded.scene.bodies]
    for i, model in enumerate(loaded.models):
        over, attach = drawn_over(model), getattr(model.config, "attach", None)
        if over is not None and over not in bodies:
            raise loaded.at(f"objects[{i}].model", no_body(over, bodies))
        if attach is not None and attach.body not in bodies:
            # The error lists all frames, which are known only after building the bodies.
            frames = build_bodies(loaded).geometry.frames if bodies else ()
            with loaded.errors_at(f"objects[{i}].model.attach"):
                frame_of(Binding(np.zeros(0, np.int32), attach.body, attach.frame), frames)


MOST = 20
"""Most mistakes in one answer."""
SUFFIXES = (".yaml", ".yml")
NEW = re.compile(r"[A-Za-z0-9][\w.-]{0,100}\.ya?ml", re.ASCII)
"""Allowed names of a new file."""
NAMED, NAME = re.compile(r"^name\s*:.*", re.MULTILINE), 64
"""Line of the scene's name in a text, and the largest number of characters of that name."""
IS_SCENE = re.compile(r"^nuno\s*:", re.MULTILINE)


class Scenes:
    """Shipped scenes by name, and the scene files of a folder by their file names, which end in .yaml or .yml."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.more: dict[str, Path] = {}
        """Scenes from elsewhere that were named when the page was opened."""
        self.changed: dict[str, str] = {}
        """Texts that replace those of files, for scenes with changes on the command line."""
        self.roots: tuple[Path, ...] = ()
        """Further folders for files of scenes."""

    def paths(self) -> dict[str, Path]:
        """Return the paths of all scenes by name, those of the folder first."""
        files = sorted(path for path in self.folder.glob("*") if path.suffix in SUFFIXES and path.is_file())
        return {path.name: path for path in files if IS_SCENE.search(text_of(path))} | self.more | shipped.scenes()

    def find(self, name: object) -> Path:
        """Return the path of a scene. Raises BadInput for an unknown name."""
        paths = self.paths()
        if not isinstance(name, str) or name not in paths:
            raise BadInput("no such scene", value=name, remedy=nearest(str(name), paths))
        return paths[name]

    def picture_of(self, name: object) -> Path:
        """Return the shipped picture of a shipped scene. Raises BadInput if there is none."""
        path = shipped.folder() / "pictures" / f"{name}.webp"
        if name not in shipped.scenes() or not path.is_file():
            raise BadInput("no such picture", value=name)
        return path

    def list(self) -> list[dict[str, Any]]:
        """Return name, scene name and description of each scene, and whether it is in the folder and has a picture."""
        entries = []
        for name, path in self.paths().items():
            try:
                data, _ = yaml_lines.parse(text_of(path), str(path))
                texts = {"scene": str(data.get("name", "")), "description": str(data.get("description") or "")}
            except BadInput as error:
                texts = {"scene": "", "description": str(error)}
            drawn = (shipped.folder() / "pictures" / f"{name}.webp").is_file()
            entries.append({"name": name, "own": path.suffix in SUFFIXES and name == path.name, "drawn": drawn} | texts)
        return entries


def text_of(path: Path) -> str:
    """Return the text of a file; empty if it is not text."""
    try:
        return path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError):
        return ""


def check(text: str, path: Path, roots: tuple[Path, ...] = ()) -> dict[str, Any]:
    """Return a text's data, the line of each of its fields, and its mistakes, worded as on the command line.

    The loader raises the first mistake. If its value can be left out, loading without it raises the next.
    """
    try:
        data, lines = yaml_lines.parse(text, str(path))
    except BadInput as error:
        return {"data": None, "lines": {}, "mistakes": [server.describe(error)]}
    mistakes: list[dict[str, Any]] = []
    left = deepcopy(data)
    while len(mistakes) < MOST:
        try:
            loaded = scene_file.load(deepcopy(left), lines, str(path), scene_file.files_of(path, roots))
            if not mistakes:
                check_named(loaded)
            break
        except BadInput as error:
            if any(error.field == mistake["field"] for mistake in mistakes):
                break  # the loader misses the value that was left out
            mistakes.append(server.describe(error))
            if not _leave_out(left, error.field, lines):
                break
    return {"data": for_json(data), "lines": {dotted(place): n for place, n in lines.items()}, "mistakes": mistakes}


def _leave_out(data: dict[str, Any], field: str | None, lines: Mapping[yaml_lines.Path, int]) -> bool:
    """Remove a field's value from the data. Return whether it existed, and is not a name or a plugin."""
    place = next((path for path in lines if path and dotted(path) == field), None)
    if place is None or place[-1] in ("name", "plugin") or not isinstance(place[-1], str):
        return False
    inside = item_at(data, place[:-1])
    return isinstance(inside, dict) and inside.pop(place[-1], None) is not None


def load(text: str, path: Path, roots: tuple[Path, ...] = ()) -> Loaded:
    """Load the scene of a text that replaces the file at a path. Raises BadInput."""
    data, lines = yaml_lines.parse(text, str(path))
    return replace(scene_file.load(data, lines, str(path), scene_file.files_of(path, roots)), path=path)


def plan(text: str, path: Path, roots: tuple[Path, ...] = ()) -> list[Row]:
    """Return the rows of `nuno plan` for the scene of a text. Raises BadInput."""
    return list(describe(load(text, path, roots)))


def save(text: str, before: str, path: Path, folder: Path, name: object) -> dict[str, Any]:
    """Write a text to its own file, or under a new name into the folder; return a message. Raises BadInput.

    `before` is the file's text when the page read it: a file that was changed since is not overwritten. A copy gets a
    new scene name for its runs and pictures, unless the user has changed that name.
    """
    name = f"{name}.yaml" if isinstance(name, str) and name and "." not in name else name
    own = path.is_file() and name == path.name and path.resolve().parent == folder.resolve()
    if not isinstance(name, str) or not (own or NEW.fullmatch(name)):
        limit = "letters, digits, - _ ., and at its end .yaml or nothing"
        raise BadInput("not the name of a scene's file", field="name", value=name, limit=limit)
    target = folder / name
    check_target(target, before if path.exists() and target.exists() and target.samefile(path) else None)
    yaml_lines.parse(text, name)
    if not own and NAMED.findall(text)[:1] == NAMED.findall(before)[:1] != []:
        stem = re.sub(r"[^A-Za-z0-9_-]", "-", target.stem)[:NAME]
        text = edit.put(text, ("name",), stem if stem[0].isalpha() else f"scene-{stem}"[:NAME], name)
    write_whole(target, text)
    files = scene_file.files_of(path)
    more = ""
    if target.parent.resolve() != path.resolve().parent:
        files_used = _files_used(text, path)
        roots = " ".join(f"--root {root}" for root in (files.folder, *files.roots)) if files_used else ""
        more = f"It names files that lie elsewhere: nuno run {name} {roots}" if roots else ""
    return {"name": name, "file": str(target), "text": more}


def check_target(target: Path, before: str | None) -> None:
    """Raise BadInput for a file that exists, unless it still has the text `before`."""
    if target.exists() and before is None:
        raise BadInput("a file of that name is there already", field="name", value=target.name, remedy="another name")
    if target.exists() and read_scene(target) != before:
        remedy = "save under another name, or open it again to go on from what it says now"
        raise BadInput("the file was changed since it was opened", str(target), remedy=remedy)


def _files_used(text: str, path: Path) -> bool:
    try:
        loaded = load(text, path)
    except BadInput:
        return False
    return bool(loaded.files.used) or any(
        isinstance(value, str) and (path.parent / value).is_file() for _, value in yaml_lines.walk(loaded.data)
    )


def schema() -> bytes:
    """Return the JSON Schema of scenes as bytes."""
    from nuno.scene.json_schema import scene_schema

    return json.dumps(scene_schema(), separators=(",", ":")).encode()


# A scene's file: adding items to its lists, and replacing it atomically.


def append_items(text: str, field: str, items: Sequence[Any], file: str) -> str:
    """Return a scene's text with `items` at the end of the list `field`, which may be missing. Raises BadInput."""
    present = yaml_lines.parse(text, file)[0].get(field)
    if present is not None and not isinstance(present, list):
        raise BadInput("this is no list that lines can be added to", file, field=field, remedy="write it as a list")
    for number, item in enumerate(items, len(present or ())):
        text = put(text, (field, number), item, file)
    return text


def write_whole(path: Path, text: str) -> None:
    """Replace a file's text completely, or leave it unchanged. Raises BadInput.

    The text is written to a new file, flushed to the disk, and moved there; permissions are kept, links followed.
    """
    path = path.resolve()
    check_unprotected(path)
    with replacing(path) as new:
        with new.open("w", encoding="utf-8", newline="") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        if path.exists():
            shutil.copymode(path, new)
