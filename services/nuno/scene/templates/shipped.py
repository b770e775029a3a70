"""Commented copies of shipped scenes."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from nuno.output_files import replacing
from nuno.scene import scene_file, shipped, yaml_lines
from nuno.scene.commented import comment
from nuno.scene.files import SceneFiles
from nuno.scene.override import apply_override, as_override
from nuno.scene.provenance import assets
from nuno.scene.scene_file import Loaded
from nuno.scene.templates.garments import name_garments
from nuno.scene.validation_errors import UNNUMBERED
from nuno_schemas.errors import BadInput


def write_after(name: str, file: Path, overrides: Sequence[str] = ()) -> list[Path]:
    """Write a commented copy of a shipped scene, and the files that it needs into its folder; return their paths, the
    scene last.

    `overrides` (`key=value`) change it; the files that they name are in the folder of `file`. Raises BadInput for an
    invalid scene, and where another file of the same name exists: nothing is overwritten.
    """
    loaded = load_after(name, file, overrides)
    files = {file.parent / name_in_scene: source for name_in_scene, source in assets(loaded).items()}
    missing = {path: source for path, source in files.items() if not _same(path, source)}
    for path in (file, *missing):
        if path.exists():
            raise BadInput("it is there already, and is not written over", value=str(path),
                           remedy=f"name another: nuno new {name} FILE.yaml")  # fmt: skip
    try:
        for path, source in missing.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            with replacing(path) as new:
                shutil.copyfile(source, new)
        with replacing(file) as new:
            new.write_text(comment(loaded), encoding="utf-8")
    except OSError as error:
        raise BadInput(f"cannot write there: {error.strerror}", value=str(file)) from None
    return [*missing, file]


def load_after(name: str, file: Path, overrides: Sequence[str]) -> Loaded:
    """Load the scene that `write_after` writes. Raises BadInput."""
    path = shipped.scenes()[name]
    titled = [as_override("name", name_garments([file.stem])[0]), *overrides]
    if not overrides:
        return scene_file.read(path, titled)
    data, lines = yaml_lines.parse(path.read_text(encoding="utf-8"), str(path))
    for item in titled:
        apply_override(data, item)
    # Of two files with one name, that in the new scene's folder counts, which may have been put there for it.
    shipped_files = scene_file.files_of(path)
    files = SceneFiles(file.parent, (shipped_files.folder, *shipped_files.roots))
    return replace(scene_file.load(data, dict.fromkeys(lines, UNNUMBERED), file.name, files), path=path)


def _same(path: Path, source: Path) -> bool:
    return path.is_file() and path.read_bytes() == source.read_bytes()
