"""`nuno schema`: JSON Schema of scenes with every installed plugin's fields, for editors."""

from __future__ import annotations

import argparse
import json

from nuno.scene.json_schema import scene_schema


def add_arguments(parser: argparse.ArgumentParser) -> None:
    del parser


def main(args: argparse.Namespace) -> int:
    del args
    print(json.dumps(scene_schema(), indent=2))
    return 0
