"""`nuno draw`: a page for drawing ridges and valleys on a cloth by hand."""

from __future__ import annotations

import argparse
import threading

from nuno.cli.common import add_config, add_scene
from nuno.draw.desk import Desk
from nuno.draw.shown import see_scene
from nuno.pages.server import serving
from nuno.scene import scene_file, shipped
from nuno.seen.follow import Follower
from nuno.seen.sight import NO_FACES, NO_POINTS, Board, Sight
from nuno.supervision import runs
from nuno_schemas.errors import BadInput


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_scene(parser)
    parser.add_argument("--no-browser", action="store_true", help="print the page's address, and open nothing")
    add_config(parser)


def main(args: argparse.Namespace) -> int:
    desk = open_desk(args)
    try:
        with serving(desk.server(), "draw", not args.no_browser):
            threading.Event().wait()
    except KeyboardInterrupt:
        print("ending", flush=True)
    finally:
        desk.close()
    return 0


def open_desk(args: argparse.Namespace) -> Desk:
    """What is drawn on: a scene, or else a run that goes on, by its name. Raises BadInput."""
    try:
        path = shipped.find(args.scene)
    except BadInput as no_scene:
        if args.scene.endswith((".yaml", ".yml")):
            raise
        try:
            return _follow(*runs.find(args.scene), args.config)
        except BadInput as no_run:
            problem = "no such scene, and no such run that goes on"
            remedy = f"{no_scene.remedy}; runs: {no_run.remedy}"
            raise BadInput(problem, value=args.scene, remedy=remedy) from None
    loaded = scene_file.read(path, args.overrides, args.root)
    return Desk(loaded, Board(see_scene(loaded)))


def _follow(run: str, endpoint: str, config: str | None) -> Desk:
    path = runs.scene_path(run)
    loaded = scene_file.read(path) if path is not None else None
    if loaded is not None:
        see_scene(loaded)
    board = Board(Sight(NO_POINTS, NO_FACES, ()))
    follower = Follower(run, endpoint, board, config)
    follower.start()
    return Desk(loaded, board, follower)
