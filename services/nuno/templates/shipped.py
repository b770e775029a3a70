"""A scene to begin from, after one that comes with nuno."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from nuno.exports.target import replacing
from nuno.scene import scene_file, shipped, yaml_lines
from nuno.scene.commented import comment
from nuno.scene.files import SceneFiles
from nuno.scene.override import apply_override, as_override
from nuno.scene.provenance import assets
from nuno.scene.scene_file import Loaded
from nuno.scene.validation_errors import UNNUMBERED
from nuno.templates.garments import name_garments
from nuno_schemas.errors import BadInput


def write_after(name: str, file: Path, overrides: Sequence[str] = ()) -> list[Path]:
    """Write a commented scene after the shipped one of a name, and beside it the files that it needs; what was written,
    the scene last.

    `overrides` (`key=value`) change it; the files that they name lie beside `file`. Raises BadInput for a scene that
    they make wrong, and where something else of a name is there already: nothing is written over.
    """
    loaded = load_after(name, file, overrides)
    files = {file.parent / beside: place for beside, place in assets(loaded).items()}
    missing = {path: place for path, place in files.items() if not _same(path, place)}
    for path in (file, *missing):
        if path.exists():
            raise BadInput("it is there already, and is not written over", value=str(path),
                           remedy=f"name another: nuno new {name} FILE.yaml")  # fmt: skip
    try:
        for path, place in missing.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            with replacing(path) as new:
                shutil.copyfile(place, new)
        with replacing(file) as new:
            new.write_text(comment(loaded), encoding="utf-8")
    except OSError as error:
        raise BadInput(f"cannot write there: {error.strerror}", value=str(file)) from None
    return [*missing, file]


def load_after(name: str, file: Path, overrides: Sequence[str]) -> Loaded:
    """The scene that `write_after` writes. Raises BadInput."""
    path = shipped.scenes()[name]
    titled = [as_override("name", name_garments([file.stem])[0]), *overrides]
    if not overrides:
        return scene_file.read(path, titled)
    data, lines = yaml_lines.parse(path.read_text(encoding="utf-8"), str(path))
    for item in titled:
        apply_override(data, item)
    # Of two files of one name that beside the new scene is meant, which may have been put there for it.
    own = scene_file.files_of(path)
    files = SceneFiles(file.parent, (own.folder, *own.roots))
    return replace(scene_file.load(data, dict.fromkeys(lines, UNNUMBERED), file.name, files), path=path)


def _same(path: Path, place: Path) -> bool:
    return path.is_file() and path.read_bytes() == place.read_bytes()
