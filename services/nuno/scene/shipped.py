"""The scenes that come with the project, by name."""

from __future__ import annotations

from importlib.resources import files as package_files
from pathlib import Path

from nuno.scene.files import near
from nuno_schemas.errors import BadInput, nearest

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
