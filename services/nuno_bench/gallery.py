"""`nuno gallery KIND`: one page with the pictures of all scenes of a kind, their numbers, and what they must show."""

from __future__ import annotations

import argparse
import base64
import io
import sys
from pathlib import Path

from nuno_bench import dye_gallery, machine, page
from nuno_bench.dye_gallery import FIXED, Shown, figure_of
from nuno_schemas.dye_picture import Picture
from nuno_schemas.errors import BadInput, nearest


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("kind", choices=["dye"], help="of scenes: dye, the figures of the dye paper")
    parser.add_argument("--scenes", metavar="A,B", help="only these, by name (default: all)")
    parser.add_argument("--out", type=Path, default=Path("recordings/gallery"), metavar="DIR",
                        help="where the page goes (default: %(default)s)")  # fmt: skip


def main(args: argparse.Namespace) -> int:
    """Run all scenes; 1 where one fails, or does not show what it must."""
    others = machine.Others()
    paths = _choose(args.scenes)
    shown = []
    for path in paths:
        print(f"{path.stem} ...", file=sys.stderr, flush=True)
        shown.append(dye_gallery.run_scene(path))
        print(f"{path.stem}: {shown[-1].said}", flush=True)
    found = dye_gallery.compare({one.name: one for one in shown})
    for row in found:
        print("  ".join(row))
    about = {"command": machine.command(), **machine.describe(), "load": others.describe()}
    args.out.mkdir(parents=True, exist_ok=True)
    target = args.out / f"{args.kind}.html"
    target.write_text(_render(shown, found, about), encoding="utf-8")
    print(f"written {target}")
    return int(any(one.failed for one in shown) or any(row[-1].startswith("missed") for row in found))


def _choose(wanted: str | None) -> list[Path]:
    """The scenes' files, in their order. Raises BadInput for a name that none of them has."""
    known = dye_gallery.scenes()
    names = list(known) if wanted is None else [name for name in wanted.split(",") if name]
    if not names:
        raise BadInput("none is named: the gallery would be empty", field="--scenes", value=wanted)
    for name in names:
        if name not in known:
            raise BadInput("no such scene", field="--scenes", value=name, remedy=nearest(name, known))
    return [path for name, path in known.items() if name in names]


def _render(shown: list[Shown], found: list[list[str]], about: dict[str, str]) -> str:
    sections: list[tuple[str, list[page.Part]]] = [
        (f"Figure {number}", [page.Pictures(_pictures([one for one in shown if figure_of(one.name) == number]))])
        for number in sorted({figure_of(one.name) for one in shown})
    ]
    if found:
        told = "Every difference that the paper describes, as a ratio of two measures; at least 1.2 is asked for."
        sections.append(("What must show", [page.Table(dye_gallery.DIFFERENCE_HEADINGS, found, told)]))
    cloths = page.Table(
        dye_gallery.PARAMETER_HEADINGS, [one.parameters for one in shown],
        "tau 3 by kind of face (I to V; IV is 1), tau 2, tau 1 and P of the yarns, r at random for each yarn, weave, "
        "cells, and yarn and gap in cells.",
    )  # fmt: skip
    dyes = page.Table(
        dye_gallery.DYE_HEADINGS, [one.dyes for one in shown],
        "D0 in water, how fast fibre fixes dye and by which isotherm, what was given, for how long it spreads, and the "
        "amount that is drawn darkest. The paper prints no constants of isotherms.",
    )  # fmt: skip
    numbers = page.Table(
        dye_gallery.NUMBER_HEADINGS, [one.numbers for one in shown],
        "Balance: how far mobile and fixed dye are from what was supplied, at worst, as a share of it.",
    )  # fmt: skip
    sections += [("Parameters", [cloths, dyes]), ("Runs", [numbers, page.Facts(about)])]
    lead = "The figures of the dye paper, each from its row of the paper's table, and where its text says otherwise, "
    return page.render("Dyed cloth", lead + "from the text too.", sections)


def _pictures(shown: list[Shown]) -> list[page.Image]:
    """Those of one figure; what fibre has fixed in a row of its own, as in the paper."""
    found = [(label == FIXED, label, one, picture) for one in shown for label, picture in one.pictures]
    return [
        page.Image(_embed(picture), f"{one.name}{', ' if label else ''}{label}. {one.description}")
        for _, label, one, picture in sorted(found, key=lambda each: each[0])
    ]


def _embed(picture: Picture) -> str:
    """A picture as a data URL."""
    from PIL import Image

    stream = io.BytesIO()
    Image.fromarray(picture).save(stream, format="PNG", optimize=True)
    return "data:image/png;base64," + base64.b64encode(stream.getvalue()).decode()
