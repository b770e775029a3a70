"""`nuno new`: a commented scene to start from."""

from __future__ import annotations

import argparse
import shlex
from pathlib import Path

from nuno.scene import shipped
from nuno.scene.templates.shipped import write_after
from nuno_schemas.errors import BadInput, nearest

KINDS = {
    "skirt": "skirt-hula",
    "fitted-skirt": "skirt-on-mannequin",
    "circle-skirt": "circle-skirt",
    "sheet": "drape-over-sphere",
    "round-cloth": "round-table",
    "ribbon": "contact/ribbon",
    "shirt": "shirt-on-mannequin",
    "poncho": "poncho",
    "trousers": "sewn/trousers",
    "dress": "sewn/dress",
    "garment": "sewn/shirt",
    "stocking": "knit/stocking-leg",
    "dye": "dye/drops",
}
"""Shipped scene that each kind copies."""


def new_arguments(parser: argparse.ArgumentParser) -> None:
    kinds = ", ".join(KINDS)
    parser.add_argument("kind", help=f"{kinds}; or any scene that comes with nuno (nuno scenes)")
    parser.add_argument("file", nargs="?", type=Path, help="what is written (default: KIND.yaml, here)")


def new_command(args: argparse.Namespace) -> int:
    """Write the scene, and the files that it needs into its folder."""
    known = shipped.scenes()
    name = KINDS.get(args.kind, args.kind)
    if name not in known:
        raise BadInput(
            "nothing of this kind to start from", value=args.kind, remedy=nearest(args.kind, [*KINDS, *known])
        )
    file: Path = args.file or Path(f"{args.kind.rsplit('/', 1)[-1]}.yaml")
    if file.suffix not in (".yaml", ".yml"):
        raise BadInput("a scene is YAML", field="FILE", value=str(file), remedy=f"{file.stem}.yaml")
    *beside, _ = write_after(name, file)
    for path in beside:
        print(f"written {path}")
    print(f"written {file}  (change it, and: nuno run {shlex.quote(str(file))})")
    return 0
