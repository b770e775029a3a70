"""What can be chosen beside a file that a scene is made of: other files of the folder, and what comes with nuno."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from nuno import registry
from nuno.scene import shipped
from nuno.studio.seen import files_of

NONE, OWN = "", "nuno:"
"""A choice of nothing, and what stands before the names of what comes with nuno."""
GARMENTS = {
    "shirt-on-mannequin": "a T-shirt cut to it", "circle-skirt": "a circle skirt",
    "skirt-on-mannequin": "a fitted skirt", "poncho": "a poncho",
}  # fmt: skip
"""Scenes of garments that are made after a body, which they call `mannequin`."""
MESHES, PATTERNS, PICTURES = (".obj", ".ply", ".stl", ".glb"), (".json",), (".png", ".jpg", ".jpeg")
Option = tuple[str, str]


@dataclass(frozen=True)
class Choice:
    """What is chosen of an offer: its name, its heading, and options of value and words, the first unless told."""

    name: str
    label: str
    options: Sequence[Option]


def bodies(folder: Path) -> Choice:
    own = [(path.name, path.name) for path in files_of(folder, MESHES)]
    return Choice("body", "body", [*own, (NONE, "the mannequin that comes with nuno")])


def patterns(folder: Path) -> Choice:
    own = [(path.name, path.name) for path in files_of(folder, PATTERNS)]
    with_nuno = [(f"{OWN}{path.name}", f"{path.stem}, with nuno") for path in sorted(sewn().glob("*.yaml"))]
    return Choice("pattern", "pattern", [*own, *with_nuno])


def motions(folder: Path) -> Choice:
    own = [(path.name, f"moved by {path.name}") for path in files_of(folder, (".bvh",))]
    return Choice("motion", "it", [(NONE, "stands"), *own, (f"{OWN}walk.bvh", "walks, with nuno")])


def fabrics(_: Path) -> Choice:
    model = registry.offering("nuno.models", "check_pattern", "reads sewing patterns")
    said = model.Config.model_json_schema()["properties"]["fabric"]
    names = next(one["enum"] for one in said["oneOf"] if "enum" in one)
    return Choice(
        "fabric", "fabric", [(name, name) for name in sorted(names, key=lambda name: name != said["default"])]
    )


def garments(_: Path) -> Choice:
    return Choice("garment", "garment", list(GARMENTS.items()))


def stencils(folder: Path) -> Choice:
    own = [(path.name, path.name) for path in files_of(folder, PICTURES)]
    return Choice("stencil", "with", [(NONE, "no stencil"), *own])


def drafts(folder: Path) -> Choice:
    own = [(path.name, path.name) for path in files_of(folder, (".wif",))]
    return Choice("draft", "draft", [*own, (NONE, "a twill that comes with nuno")])


def below(folder: Path) -> Choice:
    own = [(path.name, path.name) for path in files_of(folder, MESHES)]
    return Choice("body", "on", [(NONE, "a ball"), *own])


def sewn() -> Path:
    return shipped.folder() / "sewn" / "patterns"
