"""Arguments that several commands share."""

from __future__ import annotations

import argparse
import math
import os
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nuno.formatting import plain
from nuno.scene import scene_file, shipped, yaml_lines
from nuno.scene.override import as_override
from nuno.scene.scene_file import Loaded
from nuno.solver_selection.budget import BUDGET, Budget
from nuno_schemas.errors import BadInput
from nuno_schemas.units import to_si

if TYPE_CHECKING:
    from nuno.recording.reader import Recording


Flags = Mapping[str, tuple[str, str] | tuple[str, str, Callable[[str], object]]]
"""Flags that take a value: what it is called, help, and what reads it where it is no text."""


def add_flags(parser: argparse._ActionsContainer, flags: Flags) -> None:
    """Add flags that take a value; one whose value is called NAME... may be given again and again."""
    for flag, (metavar, text, *kind) in flags.items():
        again: dict[str, Any] = {"action": "append", "default": []} if metavar.endswith("...") else {}
        parser.add_argument(
            flag, metavar=metavar.removesuffix("..."), help=text, type=kind[0] if kind else str, **again
        )


def add_scene(parser: argparse.ArgumentParser, optional: bool = False) -> None:
    text = "a YAML file, or the name of a shipped scene (nuno scenes)"
    parser.add_argument("scene", nargs="?" if optional else None, help=text)
    add_set(parser, "change a field of the scene, e.g. solver.dt=1ms; may be repeated")
    add_flags(parser, {"--root": ("DIR...", "another folder that the scene's files may come from", Path)})


def add_budget(parser: argparse._ActionsContainer) -> None:
    text = f"how long solver: auto may try solvers (default: {BUDGET:g} s); what is known then is taken"
    add_flags(parser, {"--budget": ("TIME", text)})


def budget_of(args: argparse.Namespace) -> Budget:
    """What `--budget` gives, told of on stderr. Raises BadInput."""
    try:
        seconds = BUDGET if args.budget is None else to_si(args.budget, "s")
    except ValueError as error:
        raise BadInput(str(error), field="--budget", value=args.budget, remedy="for example --budget 5min") from None
    if not 0.0 < seconds < math.inf:
        raise BadInput("trials take some time", field="--budget", value=args.budget, limit="more than 0 s")
    return Budget(seconds, lambda text: print(text, file=sys.stderr, flush=True))


def add_set(parser: argparse._ActionsContainer, text: str) -> None:
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", dest="overrides", help=text)


def add_config(parser: argparse._ActionsContainer) -> None:
    add_flags(parser, {"--config": ("FILE", "zenoh configuration: TLS, access control")})


def add_run(parser: argparse._ActionsContainer, needed: bool = False) -> None:
    """A run that goes on, here or on another host."""
    default = "" if needed else " (default: last)"
    parser.add_argument(
        "run", nargs=None if needed else "?", default="last", help=f"a run's id or its beginning{default}"
    )
    add_flags(parser, {"--connect": ("ENDPOINT", "the run's hub, if it is on another host")})
    add_config(parser)


def find_run(args: argparse.Namespace) -> tuple[str, str]:
    """Id and endpoint of the run that is named. Raises BadInput."""
    from nuno.supervision import runs

    return (args.run, args.connect) if args.connect else runs.find(args.run)


def warn(recording: Recording) -> None:
    """Say where a recording is not complete: what is made of it is not, either."""
    from nuno.recording.gaps import shortcoming

    if problem := shortcoming(recording):
        print(plain(f"{recording.path}: {problem}"), file=sys.stderr)


def load_scene(args: argparse.Namespace) -> Loaded:
    """The scene, changed by `--set`. Raises BadInput."""
    path = shipped.find(args.scene)
    overrides, folders = find_own(path, args.overrides)
    return scene_file.read(path, overrides, [*args.root, *folders])


def find_own(scene: Path, overrides: list[str]) -> tuple[list[str], list[Path]]:
    """Overrides that name files by their paths from where the command is typed, alone or in a mapping or list, with
    the files' names instead, and the folders of these files. What the user types may be read, wherever it lies; what a
    scene says may not.

    Raises BadInput for a file that goes by the name of another one beside the scene.
    """
    named, folders = [], []
    for item in overrides:
        key, equals, text = item.partition("=")
        found: list[Path] = []
        if equals and _is_file(text):
            item = f"{key}={_name_of(text, key, scene, found)}"
        elif equals and (value := _parsed(text)) is not None:
            renamed = _rename(value, key, scene, found)
            if found:
                item = as_override(key, renamed)
        named.append(item)
        folders += found
    return named, folders


def _parsed(text: str) -> Any:
    """The mapping or list that a text stands for; None for any other, and what is wrong is said where it is read."""
    try:
        value = yaml_lines.parse_value(text)
    except BadInput:
        return None
    return value if isinstance(value, dict | list) else None


def _rename(value: Any, key: str, scene: Path, folders: list[Path]) -> Any:
    """A value with names instead of the paths of files; adds their folders."""
    if isinstance(value, dict):
        return {name: _rename(one, key, scene, folders) for name, one in value.items()}
    if isinstance(value, list):
        return [_rename(one, key, scene, folders) for one in value]
    return _name_of(value, key, scene, folders) if isinstance(value, str) and _is_file(value) else value


def _is_file(text: str) -> bool:
    """Whether a text is the path of a file, from where the command is typed."""
    own = os.path.expanduser(text)
    # os.path says no where pathlib raises: for a mapping longer than the name of a file may be, or no user's ~.
    return bool(Path(own).suffix) and os.path.isfile(own)


def _name_of(text: str, key: str, scene: Path, folders: list[Path]) -> str:
    """What a scene may call the file at a path by; adds its folder. Raises BadInput."""
    own = Path(os.path.expanduser(text))
    other = scene.resolve().parent / own.name
    if other.is_file() and not other.samefile(own):
        problem, remedy = "another file of this name lies beside the scene", "give yours another name"
        raise BadInput(problem, "--set", field=key, value=text, limit=str(other), remedy=remedy)
    folders.append(own.resolve().parent if own.is_symlink() else own.parent.resolve())
    return own.name
