"""Pages in the browser: `nuno studio` and `nuno draw`."""

from __future__ import annotations

import argparse
import threading
from copy import deepcopy
from pathlib import Path
from urllib.parse import quote

from nuno.cli.common import add_config, add_scene
from nuno.runtime import runs
from nuno.scene import scene_file, shipped, yaml_lines
from nuno.scene.edit import put
from nuno.scene.files import MARK, read_scene
from nuno.scene.override import apply_override, item_at
from nuno.studio.desk import Desk
from nuno.studio.draw import require_lines
from nuno.studio.live_view import see_objects
from nuno.studio.server import serving
from nuno_schemas.errors import BadInput


def studio_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--no-browser", action="store_true", help="print the page's address, and open nothing")


def studio_command(args: argparse.Namespace) -> int:
    return serve(Desk(), "studio", "", not args.no_browser)


def serve(desk: Desk, name: str, place: str, opened: bool) -> int:
    """Serve the page, opened at `place`, until Ctrl-C; return the exit code."""
    try:
        with serving(desk.server(), name, opened, place):
            threading.Event().wait()
    except KeyboardInterrupt:
        print("ending", flush=True)
    finally:
        desk.close()
    return 0


# `nuno draw`: the studio's page, open on the cloth of a scene or of a run, to draw ridges and valleys by hand.


def draw_arguments(parser: argparse.ArgumentParser) -> None:
    add_scene(parser)
    parser.add_argument("--no-browser", action="store_true", help="print the page's address, and open nothing")
    add_config(parser)


def draw_command(args: argparse.Namespace) -> int:
    desk, place = open_desk(args)
    return serve(desk, "draw", place, not args.no_browser)


def open_desk(args: argparse.Namespace) -> tuple[Desk, str]:
    """Return the page's desk, and the place of a scene on it, or of an active run by its name. Raises BadInput."""
    try:
        path = shipped.find(args.scene)
    except BadInput as no_scene:
        if args.scene.endswith((".yaml", ".yml")):
            raise
        try:
            run, _ = runs.find(args.scene)
        except BadInput as no_run:
            problem = "no such scene, and no such run that goes on"
            remedy = f"{no_scene.remedy}; runs: {no_run.remedy}"
            raise BadInput(problem, value=args.scene, remedy=remedy) from None
        desk, path_of_run = Desk(), runs.scene_path(run)
        entry = _open(desk, path_of_run, [], []) if path_of_run is not None else ""
        desk.attach(run, entry, args.config)
        return desk, _place(entry)
    desk = Desk()
    return desk, _place(_open(desk, path, args.overrides, args.root))


def _open(desk: Desk, path: Path, overrides: list[str], roots: list[Path]) -> str:
    """Add a scene to the page; return its name there. Raises BadInput for one that takes no lines."""
    loaded = scene_file.read(path, overrides, roots)
    require_lines(loaded, see_objects(loaded)[2])
    scenes = desk.scenes
    names = {file.resolve(): name for name, file in scenes.paths().items()}
    entry = names.get(path.resolve(), path.name if path.name not in names.values() else str(path))
    if path.resolve() not in names:
        scenes.more[entry] = path
    scenes.roots = tuple(roots)
    if overrides:
        scenes.changed[entry] = _changed(read_scene(path).removeprefix(MARK), overrides, path.name)
    return entry


def _changed(text: str, overrides: list[str], file: str) -> str:
    """Return a scene's text with the changes of `--set` in it. Raises BadInput."""
    for item in overrides:
        data = deepcopy(yaml_lines.parse(text, file)[0])
        place = apply_override(data, item)
        text = put(text, place, item_at(data, place), file, item.partition("=")[2])
    return text


def _place(entry: str) -> str:
    return f"#draw={quote(entry, safe='')}"
