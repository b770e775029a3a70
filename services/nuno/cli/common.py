"""Arguments that several commands share."""

from __future__ import annotations

import argparse
import contextlib
import logging
import math
import os
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nuno.formatting import plain
from nuno.scene import scene_file, shipped, yaml_lines
from nuno.scene.override import as_override
from nuno.scene.scene_file import Loaded
from nuno.simulation.solver_selection.trials import BUDGET, Budget
from nuno_schemas.errors import BadInput
from nuno_schemas.units import to_si

if TYPE_CHECKING:
    from nuno.recording.reader import Recording


Flags = Mapping[str, tuple[str, str] | tuple[str, str, Callable[[str], object]]]
"""Flags with a value: its name, help, and the function that parses it unless it is a text."""


def add_flags(parser: argparse._ActionsContainer, flags: Flags) -> None:
    """Add flags with a value; one whose value is called NAME... may be repeated."""
    for flag, (metavar, text, *kind) in flags.items():
        repeated: dict[str, Any] = {"action": "append", "default": []} if metavar.endswith("...") else {}
        parser.add_argument(
            flag, metavar=metavar.removesuffix("..."), help=text, type=kind[0] if kind else str, **repeated
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
    """Return the budget of `--budget`, which reports on stderr. Raises BadInput."""
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
    """Add the arguments for an active run, here or on another host."""
    default = "" if needed else " (default: last)"
    parser.add_argument(
        "run", nargs=None if needed else "?", default="last", help=f"a run's id or its beginning{default}"
    )
    add_flags(parser, {"--connect": ("ENDPOINT", "the run's hub, if it is on another host")})
    add_config(parser)


def find_run(args: argparse.Namespace) -> tuple[str, str]:
    """Return id and endpoint of the named run. Raises BadInput."""
    from nuno.runtime import runs

    return (args.run, args.connect) if args.connect else runs.find(args.run)


def warn(recording: Recording) -> None:
    """Print a warning if a recording is incomplete."""
    from nuno.recording.reader import shortcoming

    if problem := shortcoming(recording):
        print(plain(f"{recording.path}: {problem}"), file=sys.stderr)


@contextlib.contextmanager
def compilation_notice() -> Iterator[None]:
    """Say on stderr, once, that pictures wait for the compiler, if they do."""
    compiler = logging.getLogger("nuno.kernels.compiler")

    class Teller(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            compiler.removeHandler(self)
            print("compiling; the next picture of this kind finds it ready", file=sys.stderr, flush=True)

    teller = Teller()
    compiler.setLevel(logging.INFO)
    compiler.addHandler(teller)
    try:
        yield
    finally:
        compiler.removeHandler(teller)


def load_scene(args: argparse.Namespace) -> Loaded:
    """Load the scene with the overrides of `--set`. Raises BadInput."""
    path = shipped.find(args.scene)
    overrides, folders = find_own(path, args.overrides)
    return scene_file.read(path, overrides, [*args.root, *folders])


def find_own(scene: Path, overrides: list[str]) -> tuple[list[str], list[Path]]:
    """Replace paths of files from the working folder in overrides, alone or in a mapping or list, by the files' names;
    return the overrides and the files' folders. The user's arguments may name any file, but a scene only its own.

    Raises BadInput for a file with the name of another one in the scene's folder.
    """
    named, folders = [], []
    for item in overrides:
        key, equals, text = item.partition("=")
        folders_of_item: list[Path] = []
        if equals and _is_file(text):
            item = f"{key}={_name_of(text, key, scene, folders_of_item)}"
        elif equals and (value := _parsed(text)) is not None:
            renamed = _rename(value, key, scene, folders_of_item)
            if folders_of_item:
                item = as_override(key, renamed)
        named.append(item)
        folders += folders_of_item
    return named, folders


def _parsed(text: str) -> Any:
    """Return the mapping or list of a YAML text; None for others, whose errors are raised later."""
    try:
        value = yaml_lines.parse_value(text)
    except BadInput:
        return None
    return value if isinstance(value, dict | list) else None


def _rename(value: Any, key: str, scene: Path, folders: list[Path]) -> Any:
    """Return a value with names instead of the paths of files; add their folders to `folders`."""
    if isinstance(value, dict):
        return {name: _rename(item, key, scene, folders) for name, item in value.items()}
    if isinstance(value, list):
        return [_rename(item, key, scene, folders) for item in value]
    return _name_of(value, key, scene, folders) if isinstance(value, str) and _is_file(value) else value


def _is_file(text: str) -> bool:
    """Return whether a text is the path of a file, from the working folder."""
    path = os.path.expanduser(text)
    # os.path returns False where pathlib raises: for a mapping longer than a file's name may be, or an unknown ~.
    return bool(Path(path).suffix) and os.path.isfile(path)


def _name_of(text: str, key: str, scene: Path, folders: list[Path]) -> str:
    """Return the name of the file at a path for a scene; add its folder to `folders`. Raises BadInput."""
    path = Path(os.path.expanduser(text))
    other = scene.resolve().parent / path.name
    if other.is_file() and not other.samefile(path):
        problem, remedy = "another file of this name lies beside the scene", "give yours another name"
        raise BadInput(problem, "--set", field=key, value=text, limit=str(other), remedy=remedy)
    folders.append(path.resolve().parent if path.is_symlink() else path.parent.resolve())
    return path.name
