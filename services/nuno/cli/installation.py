"""What is installed, for authors of scenes: `nuno plugins`, `nuno scenes` and `nuno schema`; and the add-on
for Blender.
"""

from __future__ import annotations

import argparse
import json
from importlib import import_module
from importlib.resources import files
from pathlib import Path

from nuno.output_files import writing
from nuno.plugin_contract import registry
from nuno.scene import shipped, yaml_lines
from nuno_schemas.plugin import GROUPS

REFERENCES = {
    "messages": ("nuno.cli.reference", "what a run publishes"),
    "fields": ("nuno.cli.reference", "every field of a scene"),
    "commands": ("nuno.cli.reference", "every command and its arguments"),
}
"""Generated pages of the documentation, each by `describe_NAME` of a module."""


def plugins_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("group", nargs="?", help="only this kind, e.g. nuno.integrators")


def plugins_command(args: argparse.Namespace) -> int:
    """Print the plugins without importing any."""
    for group, meaning in GROUPS.items():
        if args.group in (None, group, group.removeprefix("nuno.")):
            print(f"{group}  ({meaning})")
            for name, points in sorted(registry.claims(group).items()):
                twice = "" if len(points) == 1 else "   claimed twice: a scene that names it is refused"
                print(f"  {name:20} {', '.join(map(registry.package, points))}{twice}")
    return 0


def scenes_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--paths", action="store_true", help="print where they are")


def scenes_command(args: argparse.Namespace) -> int:
    for name, path in shipped.scenes().items():
        data, _ = yaml_lines.parse(path.read_text(), str(path))
        print(path if args.paths else f"{name:28} {data.get('description', '')}")
    return 0


def blender_addon_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "file", nargs="?", type=Path, default=Path("cloth_by_nuno.py"), metavar="FILE",
        help="where it is written (default: cloth_by_nuno.py)",
    )  # fmt: skip


def blender_addon_command(args: argparse.Namespace) -> int:
    with writing(args.file, ".py") as new:
        new.write_text((files("nuno.exports") / "blender_addon.py").read_text(encoding="utf-8"), encoding="utf-8")
    print(args.file)
    return 0


def schema_arguments(parser: argparse.ArgumentParser) -> None:
    for name, (_, what) in REFERENCES.items():
        parser.add_argument(f"--{name}", action="store_true", help=f"the reference of {what} instead, as Markdown")


def schema_command(args: argparse.Namespace) -> int:
    if name := next((name for name in REFERENCES if getattr(args, name)), ""):
        print(getattr(import_module(REFERENCES[name][0]), f"describe_{name}")(), end="")
    else:
        from nuno.scene.json_schema import scene_schema

        print(json.dumps(scene_schema(), indent=2))
    return 0
