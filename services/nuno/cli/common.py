"""Arguments that several commands share."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from nuno import scene_file
from nuno.scene_file import Loaded
from nuno_schemas.errors import BadInput

if TYPE_CHECKING:
    from nuno.recording.reader import Recording


def add_scene(parser: argparse.ArgumentParser, optional: bool = False) -> None:
    parser.add_argument(
        "scene", nargs="?" if optional else None, help="a YAML file, or the name of a shipped scene (nuno scenes)"
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        dest="overrides",
        help="change a field of the scene, e.g. solver.dt=1ms; may be repeated",
    )
    parser.add_argument(
        "--root",
        action="append",
        default=[],
        type=Path,
        metavar="DIR",
        help="another folder that the scene's files may come from",
    )


def add_config(parser: argparse._ActionsContainer) -> None:
    parser.add_argument("--config", metavar="FILE", help="zenoh configuration: TLS, access control")


def warn(recording: Recording) -> None:
    """Say where a recording is not complete: what is made of it is not, either."""
    from nuno.recording.gaps import shortcoming

    if problem := shortcoming(recording):
        print(f"{recording.path}: {problem}", file=sys.stderr)


def load_scene(args: argparse.Namespace) -> Loaded:
    """The scene, changed by `--set`. Raises BadInput."""
    path = scene_file.find(args.scene)
    overrides, folders = find_own(path, args.overrides)
    return scene_file.read(path, overrides, [*args.root, *folders])


def find_own(scene: Path, overrides: list[str]) -> tuple[list[str], list[Path]]:
    """Overrides whose value is the path of a file, from where the command is typed, with its name instead, and the
    folders of these files. What the user types may be read, wherever it lies; what a scene says may not.

    Raises BadInput for a file that goes by the name of another one beside the scene.
    """
    named, folders = [], []
    for item in overrides:
        key, equals, value = item.partition("=")
        own = Path(os.path.expanduser(value))
        # os.path says no where pathlib raises: for a mapping longer than the name of a file may be, or no user's ~.
        if not (equals and own.suffix and os.path.isfile(own)):
            named.append(item)
            continue
        other = scene.resolve().parent / own.name
        if other.is_file() and not other.samefile(own):
            problem, remedy = "another file of this name lies beside the scene", "give yours another name"
            raise BadInput(problem, "--set", field=key, value=value, limit=str(other), remedy=remedy)
        named.append(f"{key}={own.name}")
        folders.append(own.resolve().parent if own.is_symlink() else own.parent.resolve())
    return named, folders
