"""`nuno scenes`: the scenes that come with nuno."""

from __future__ import annotations

import argparse

from nuno.scene import scene_file, yaml_lines


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--paths", action="store_true", help="print where they are")


def main(args: argparse.Namespace) -> int:
    for folder in ("", *scene_file.FOLDERS):
        for name, path in scene_file.shipped(folder).items():
            data, _ = yaml_lines.parse(path.read_text(), str(path))
            print(path if args.paths else f"{name:28} {data.get('description', '')}")
    return 0
