"""`nuno new`: a commented scene to start from."""

from __future__ import annotations

import argparse
import shlex
import shutil
from pathlib import Path

from nuno.cli.worn import name_garments
from nuno.scene import scene_file, shipped
from nuno.scene.commented import comment
from nuno.scene.override import as_override
from nuno.scene.provenance import assets
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
"""The scene that each is made after."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    kinds = ", ".join(KINDS)
    parser.add_argument("kind", help=f"{kinds}; or any scene that comes with nuno (nuno scenes)")
    parser.add_argument("file", nargs="?", type=Path, help="what is written (default: KIND.yaml, here)")


def main(args: argparse.Namespace) -> int:
    """Write the scene, and the files that it needs, beside it."""
    known = shipped.scenes()
    name = KINDS.get(args.kind, args.kind)
    if name not in known:
        raise BadInput(
            "nothing of this kind to start from", value=args.kind, remedy=nearest(args.kind, [*KINDS, *known])
        )
    file: Path = args.file or Path(f"{args.kind.rsplit('/', 1)[-1]}.yaml")
    if file.suffix not in (".yaml", ".yml"):
        raise BadInput("a scene is YAML", field="FILE", value=str(file), remedy=f"{file.stem}.yaml")
    (title,) = name_garments([file.stem])
    loaded = scene_file.read(known[name], [as_override("name", title)])
    files = {file.parent / beside: place for beside, place in assets(loaded).items()}
    missing = {path: place for path, place in files.items() if not _same(path, place)}
    for path in (file, *missing):
        if path.exists():
            raise BadInput("it is there already, and is not written over", value=str(path),
                           remedy=f"name another: nuno new {args.kind} FILE.yaml")  # fmt: skip
    try:
        for path, place in missing.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(place, path)
            print(f"written {path}")
        file.write_text(comment(loaded), encoding="utf-8")
    except OSError as error:
        raise BadInput(f"cannot write there: {error.strerror}", value=str(file)) from None
    print(f"written {file}  (change it, and: nuno run {shlex.quote(str(file))})")
    return 0


def _same(path: Path, place: Path) -> bool:
    return path.is_file() and path.read_bytes() == place.read_bytes()
