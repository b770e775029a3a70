"""`nuno gallery KIND`: one page with the pictures of all scenes of a kind, their numbers, and what they must show."""

from __future__ import annotations

import argparse
import base64
import io
import sys
import time
from pathlib import Path
from typing import Any

from nuno.ahead import Pace, run_seconds
from nuno.scene import scene_file
from nuno.words import roughly
from nuno_bench import machine
from nuno_bench.gallery import dye, knit, wrinkle
from nuno_bench.gallery.kind import DIFFERENCE_HEADINGS, Kind, Shown
from nuno_bench.report import page
from nuno_schemas.dye_picture import Picture
from nuno_schemas.errors import BadInput, nearest

KINDS: dict[str, Kind[Any]] = {"dye": dye.KIND, "knit": knit.KIND, "wrinkle": wrinkle.KIND}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("kind", choices=list(KINDS), help="of scenes: dye, the figures of the dye paper; knit, all "
                        "knits; wrinkle, lines drawn on cloth")  # fmt: skip
    parser.add_argument("--scenes", metavar="A,B", help="only these, by name (default: all)")
    parser.add_argument("--out", type=Path, default=Path("recordings/gallery"), metavar="DIR",
                        help="where the page goes (default: %(default)s)")  # fmt: skip


def main(args: argparse.Namespace) -> int:
    """Run all scenes; 1 where one fails, or does not show what it must."""
    kind, others = KINDS[args.kind], machine.Others()
    paths = _choose(kind, args.scenes)
    print(f"a frame of each of {len(paths)} scenes is tried, to see how long they take", file=sys.stderr, flush=True)
    pace = Pace({path.stem: run_seconds(scene_file.read(path)) for path in paths})
    print(f"steps take {roughly(pace.left)}, compiling and pictures apart", file=sys.stderr, flush=True)
    shown = []
    for i, path in enumerate(paths):
        left = f", {roughly(pace.left)} left" if i else ""
        print(f"{path.stem}, {i + 1} of {len(paths)}{left} ...", file=sys.stderr, flush=True)
        begin = time.perf_counter()
        shown.append(kind.run_scene(path))
        pace.taken[path.stem] = time.perf_counter() - begin
        print(f"{path.stem}: {_said(kind, shown[-1])}", flush=True)
    found = kind.compare({one.name: one for one in shown if not one.failed})
    for row in found:
        print("  ".join(row))
    about = {"command": machine.command(), **machine.describe(), "load": others.describe()}
    args.out.mkdir(parents=True, exist_ok=True)
    target = args.out / f"{args.kind}.html"
    target.write_text(_render(kind, shown, found, about), encoding="utf-8")
    print(f"written {target}")
    return int(any(one.failed for one in shown) or any(row[-1].startswith("missed") for row in found))


def _choose(kind: Kind[Any], wanted: str | None) -> list[Path]:
    """The scenes' files, in their order. Raises BadInput for a name that none of them has."""
    known = kind.scenes()
    names = list(known) if wanted is None else [name for name in wanted.split(",") if name]
    if not names:
        raise BadInput("none is named: the gallery would be empty", field="--scenes", value=wanted)
    for name in names:
        if name not in known:
            raise BadInput("no such scene", field="--scenes", value=name, remedy=nearest(name, known))
    return [path for name, path in known.items() if name in names]


def _said(kind: Kind[Any], one: Shown[Any]) -> str:
    """A scene's numbers in a line, or why it failed."""
    told = ", ".join(f"{h} {v}" for h, v in zip(kind.numbers.headings[1:], one.numbers[1:], strict=True) if v)
    return f"failed: {one.failed}" if one.failed else told or "drawn"


def _render(kind: Kind[Any], shown: list[Shown[Any]], found: list[list[str]], about: dict[str, str]) -> str:
    headings = dict.fromkeys(kind.section(one.name) for one in shown)
    sections: list[tuple[str, list[page.Part]]] = [
        (heading, [page.Pictures(_pictures(kind, [one for one in shown if kind.section(one.name) == heading]))])
        for heading in headings
    ]
    if lost := [[one.name, f"failed, {one.failed}"] for one in shown if one.failed]:
        where = "What these show is where they got to; what must show is not asked of them."
        sections.append(("Failed", [page.Table(("scene", "why"), lost, where)]))
    if found:
        sections.append(("What must show", [page.Table(DIFFERENCE_HEADINGS, found, kind.differences)]))
    parameters = [
        page.Table(columns.headings, [one.parameters[table] for one in shown], columns.caption)
        for table, columns in enumerate(kind.parameters)
    ]
    told = [one.numbers for one in shown if any(one.numbers[1:])]
    numbers = [page.Table(kind.numbers.headings, told, kind.numbers.caption)] if told else []
    sections += [("Parameters", [*parameters]), ("Runs", [*numbers, page.Facts(about)])]
    return page.render(kind.title, kind.lead, sections)


def _pictures(kind: Kind[Any], shown: list[Shown[Any]]) -> list[page.Image]:
    """Those of one section, those that stand apart last; what a scene is stands below its first picture alone."""
    found = [
        (label == kind.apart != "", f"{one.name}{', ' if label else ''}{label}.", "" if i else one.description, picture)
        for one in shown
        for i, (label, picture) in enumerate(one.pictures)
    ]
    return [
        page.Image(_embed(picture), f"{name} {description}".strip())
        for _, name, description, picture in sorted(found, key=lambda each: each[0])
    ]


def _embed(picture: Picture) -> str:
    """A picture as a data URL."""
    from PIL import Image

    stream = io.BytesIO()
    Image.fromarray(picture).save(stream, format="PNG", optimize=True)
    return "data:image/png;base64," + base64.b64encode(stream.getvalue()).decode()
