"""The part of `nuno export` that writes yarns as curves."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from nuno.recording.reader import Recording
from nuno_schemas.errors import BadInput

SETTINGS = ("samples", "radius", "curl")


def settings_of(args: argparse.Namespace) -> dict[str, Any]:
    """Settings that the command line gives."""
    given = {name: getattr(args, name) for name in SETTINGS if getattr(args, name) is not None}
    if "," in given.get("radius", ""):
        given["radius"] = given["radius"].split(",")
    return given


def check_wish(recording: Recording, args: argparse.Namespace) -> None:
    """Raises BadInput for yarns that cannot be written as they are asked for: before the first file is."""
    if args.yarns is None:
        for name in ("form", *SETTINGS):
            if getattr(args, name) is not None:
                raise BadInput("for yarns as curves", field=f"--{name}", remedy="add --yarns out.npz")
        return
    from nuno.export import cloth, curves

    if recording.dyed_alone:
        raise BadInput("a recording of dye holds no knit", str(recording.path), field="--yarns", remedy="leave it out")
    curves.check_yarns(args.yarns)
    if all(piece.yarns is None for piece in cloth.read_pieces(recording)):
        remedy = "yarns are what the model knit makes"
        raise BadInput("the recording's cloth has no yarns", str(recording.path), field="--yarns", remedy=remedy)
    cloth.read_frame(recording, args.frame)
    curves.find_operation(args.form or "smooth", settings_of(args))


def prepare_yarns(recording: Recording, args: argparse.Namespace) -> Callable[[], Path]:
    """Make the curves; what writes them, and says what became of the links. Raises BadInput."""
    from nuno.export import cloth, curves

    form: curves.Form = args.form or "smooth"
    path: Path = args.yarns
    shown = cloth.read_frame(recording, args.frame)
    made = curves.make_yarns(recording, shown, form, settings_of(args))

    def write() -> Path:
        curves.write_curves(path, made, shown)
        print(tell_yarns(form, made.facts), file=sys.stderr)
        return path

    return write


def tell_yarns(form: str, facts: Mapping[str, float]) -> str:
    """What an operation did, in words."""
    count = {name: f"{int(value):,}" for name, value in facts.items()}
    text = f"{form} yarns: {count['links']} links, {count['points']} points"
    if "deepest" not in facts:
        return f"{text}; no body is a mesh, so nothing is in their way"
    text += f"; {count['repaired']} links cut through the body and were repaired, by {count['inserted']} points"
    if facts["lost"]:
        text += f"; {count['lost']} could not be"
    return f"{text}; deepest of {count['samples']} samples: {1e6 * facts['deepest']:.3g} um"
