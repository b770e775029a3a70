"""Arguments that several commands share."""

from __future__ import annotations

import argparse
from pathlib import Path

from nuno import scene_file
from nuno.scene_file import Loaded


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


def load_scene(args: argparse.Namespace) -> Loaded:
    return scene_file.read(scene_file.find(args.scene), args.overrides, args.root)
