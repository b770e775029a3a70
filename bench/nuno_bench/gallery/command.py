"""`nuno gallery KIND`: one page with the pictures of all scenes of a kind, and what was measured; and
`nuno gallery papers`: one page over the four papers.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from nuno.cli.common import add_flags
from nuno.exports.cloth import as_url
from nuno.formatting import roughly
from nuno.python_api.plan import RuntimeEstimate, run_seconds
from nuno.scene import scene_file
from nuno.scene.templates import Garment, describe_worn, name_garments
from nuno_bench import machine, options
from nuno_bench.gallery import contact, dye, knit, sewn, skirt, wrinkle
from nuno_bench.gallery.kind import Figure, Gallery, ShownScene, Verdict, judge_figures
from nuno_bench.report import page, plots
from nuno_schemas.errors import BadInput

KINDS: dict[str, Gallery] = {
    "contact": contact.KIND, "dye": dye.KIND, "knit": knit.KIND, "sewn": sewn.KIND, "skirt": skirt.KIND,
    "wrinkle": wrinkle.KIND,
}  # fmt: skip
PAPERS = {"skirt": "skirt", "knit": "stocking", "dye": "dye", "wrinkle": "wrinkle"}
"""Galleries of a paper's figures, and what the paper is about."""
ALL_PAPERS = "papers"
FIGURE_HEADINGS = ("figure", "what the paper says", "criterion", "here", "verdict")
NEEDED = "--patterns, --body"


def gallery_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("kind", choices=[*KINDS, ALL_PAPERS], help="of scenes: contact, cloth that meets cloth; dye, "
                        "knit, skirt and wrinkle, the figures of the papers; sewn, garments from patterns; papers, the "
                        "figures of all papers")  # fmt: skip
    parser.add_argument("--scenes", metavar="A,B", help="only these, by name (default: all)")
    parser.add_argument("--out", type=Path, default=Path("recordings/gallery"), metavar="DIR",
                        help="where the page goes (default: %(default)s)")  # fmt: skip
    options.add_shared(parser, "--docs")
    add_pattern_arguments(parser)


def gallery_command(args: argparse.Namespace) -> int:
    """Run all scenes; 1 where one fails, or a figure is not reproduced and no sweep says why."""
    check_patterns(args)
    if args.kind in ("knit", ALL_PAPERS):
        plots.require_matplotlib()
    section = f"gallery {args.kind}"
    page.check_section(args.docs, section)
    if args.kind == ALL_PAPERS:
        return show_papers(args, section)
    kind = KINDS[args.kind]
    with tempfile.TemporaryDirectory(prefix="nuno-") as folder:
        if args.patterns:
            own = write_pattern_scenes(args, Path(folder))
            kind = replace(kind, scenes=lambda: own, lead=f"Patterns that were put on {args.body.name}, one by one.")
        others = machine.OtherLoad()
        shown = run_scenes(kind, choose(kind, args.scenes))
    found = judge(kind, shown)
    report(kind, found, machine.about(others)).write(args.out / f"{args.kind}.html", None, args.docs, section)
    return int(not found.stands)


def show_papers(args: argparse.Namespace, section: str) -> int:
    """Run the scenes of all papers' figures, and write one page; return the exit code."""
    others = machine.OtherLoad()
    used = {name: {scene for figure in KINDS[name].figures for scene in figure.scenes} for name in PAPERS}
    wanted = {name: [path for scene, path in KINDS[name].scenes().items() if scene in used[name]] for name in PAPERS}
    if args.scenes is not None:
        names, every = options.names_of(args.scenes), {path.stem for paths in wanted.values() for path in paths}
        options.require_known(names, every, "scene", "--scenes")
        wanted = {name: [path for path in paths if path.stem in names] for name, paths in wanted.items()}
    sections, rows, stands = list[tuple[str, Sequence[page.Part]]](), list[list[str]](), True
    for name, paths in wanted.items():
        if paths:
            kind = KINDS[name]
            found = judge(kind, run_scenes(kind, paths))
            stands = stands and found.stands
            of = f"{PAPERS[name].capitalize()} paper"
            rows += [[f"{PAPERS[name]}, {row[0]}", *row[1:]] for row in figure_rows(found.verdicts)]
            sections += [(f"{of}: {heading}", parts) for heading, parts in figure_sections(kind, found)]
            sections.append((f"{of}: failed", [failures(found)]))
    table = page.Table(FIGURE_HEADINGS, rows, prose=True)
    lead = "What each figure of the four papers says, and whether it can be seen here."
    made = page.Report("Figures of the papers", lead, [("", [table]), *sections], machine.about(others), {}, [table])
    made.write(args.out / f"{ALL_PAPERS}.html", None, args.docs, section)
    return int(not stands)


def run_scenes(kind: Gallery, paths: list[Path]) -> list[ShownScene]:
    """Run scenes of a kind one by one, and say how long they take. Raises BadInput if none of them can be run."""
    number, shown, pace = len(paths), list[ShownScene](), RuntimeEstimate({path.stem: 1.0 for path in paths})
    if not kind.alike:
        print(
            f"a frame of each of {len(paths)} scenes is tried, to see how long they take", file=sys.stderr, flush=True
        )
        pace = RuntimeEstimate({})
        for path in paths:
            try:
                pace.expected[path.stem] = run_seconds(scene_file.read(path))
            except BadInput as error:
                shown.append(_refused(path, error))
        print(f"steps take {roughly(pace.left)}, compiling and pictures apart", file=sys.stderr, flush=True)
    paths = [path for path in paths if path.stem in pace.expected]
    for i, path in enumerate(paths):
        left = f", {roughly(pace.left)} left" if i else ""
        print(f"{path.stem}, {i + 1} of {len(paths)}{left} ...", file=sys.stderr, flush=True)
        begin = time.perf_counter()
        try:
            shown.append(kind.run_scene(path))
        except BadInput as error:
            shown.append(_refused(path, error))
        pace.taken[path.stem] = time.perf_counter() - begin
        print(f"{path.stem}: {f'failed: {shown[-1].failed}' if shown[-1].failed else 'drawn'}", flush=True)
    if all(one.refused for one in shown):
        raise BadInput(f"none of {number} scenes can be run")
    return shown


class Judged(NamedTuple):
    """Scenes that were run, and the verdicts on their figures."""

    shown: Sequence[ShownScene]
    verdicts: list[Verdict]

    @property
    def stands(self) -> bool:
        """Whether no scene failed, and every figure stands."""
        return not any(one.failed for one in self.shown) and all(one.stands for one in self.verdicts)


def judge(kind: Gallery, shown: Sequence[ShownScene]) -> Judged:
    """Judge the figures whose scenes did not fail, and print the verdicts."""
    found = Judged(shown, judge_figures(kind.figures, {one.name: one for one in shown if not one.failed}))
    for row in figure_rows(found.verdicts):
        print("  ".join(row))
    return found


def _refused(path: Path, error: BadInput) -> ShownScene:
    """A scene that would not start."""
    print(f"{path.stem}: {error}", file=sys.stderr, flush=True)
    return ShownScene(path.stem, "", failed=str(error), refused=True)


def choose(kind: Gallery, wanted: str | None) -> list[Path]:
    """The scenes' files, in their order. Raises BadInput for a name that none of them has."""
    known = kind.scenes()
    names = list(known) if wanted is None else options.names_of(wanted)
    if not names:
        raise BadInput("none is named: the gallery would be empty", field="--scenes", value=wanted)
    options.require_known(names, known, "scene", "--scenes")
    return [path for name, path in known.items() if name in names]


def report(kind: Gallery, found: Judged, about: dict[str, str]) -> page.Report:
    """The page: figures, other pictures by section, what failed and what was measured."""
    own: dict[str, list[ShownScene]] = {}
    for one in found.shown:
        if not any(one.name in verdict.figure.scenes for verdict in found.verdicts):
            own.setdefault(kind.section(one.name), []).append(one)
    measured = replace(kind.table(found.shown), caption=kind.measures)
    figures = page.Table(FIGURE_HEADINGS, figure_rows(found.verdicts), prose=True)
    sections: page.Sections = [
        ("", [figures]),
        *figure_sections(kind, found),
        *((heading, [page.Pictures(_pictures(kind, ones))]) for heading, ones in own.items()),
        ("Failed", [failures(found)]),
        ("Measured", [measured]),
    ]
    return page.Report(kind.title, kind.lead, sections, about, {}, [figures, measured])


def failures(found: Judged) -> page.Table:
    """A row a scene that failed."""
    lost = [[one.name, f"failed, {one.failed}"] for one in found.shown if one.failed]
    where = "What these show is where they got to; no figure is judged by them."
    return page.Table(("scene", "why"), lost, where)


def figure_rows(verdicts: Sequence[Verdict]) -> list[list[str]]:
    """Rows under FIGURE_HEADINGS."""
    return [
        [one.figure.number, one.figure.sentence, one.figure.criterion, one.finding.value, one.word] for one in verdicts
    ]


def figure_sections(kind: Gallery, found: Judged) -> list[tuple[str, list[page.Part]]]:
    """A section a figure: what the paper says, our pictures, criterion, value and verdict, readings and sweep.

    The reading of a figure that is not reproduced is followed by why. A table that several share stands under the
    first.
    """
    sections, figures = list[tuple[str, list[page.Part]]](), [one.figure for one in found.verdicts]
    above: dict[int, str] = {}
    for one in found.verdicts:
        own = [
            replace(
                scene, pictures=[each for each in scene.pictures if _home(scene.name, each[0], figures) is one.figure]
            )
            for scene in found.shown
        ]
        judged = page.Table(("criterion", "here", "verdict"), [[one.figure.criterion, one.finding.value, one.word]],
                            prose=True)  # fmt: skip
        parts: list[page.Part] = [f"The paper: {one.figure.sentence}", page.Pictures(_pictures(kind, own)), judged]
        texts: list[page.Part] = [f"Reading: {one.figure.reading}" if one.figure.reading else "",
                 "" if one.finding.holds else one.finding.why]  # fmt: skip
        if one.swept is not None:
            first = above.setdefault(id(one.swept), one.figure.number)
            texts.append(one.swept if first == one.figure.number else f"The table stands under figure {first}.")
        sections.append((f"Figure {one.figure.number}", [*parts, *texts]))
    return sections


def _home(scene: str, label: str, figures: Sequence[Figure]) -> Figure | None:
    """The figure that a picture stands under: of those that take it the first that names its label, else the first
    whose own scene it shows, else the first.
    """
    fitting = [one for one in figures if scene in one.scenes and (not one.labels or label.startswith(one.labels))]
    return min(fitting, key=lambda one: (not one.labels, one.scenes[0] != scene), default=None)


def _pictures(kind: Gallery, shown: Sequence[ShownScene]) -> list[page.Image]:
    """Return the pictures of one section, those that stand apart last; a scene's first caption describes it."""
    found = []
    for one in shown:
        for i, (label, picture) in enumerate(one.pictures):
            caption = f"{one.name}{', ' if label else ''}{label}. {'' if i else one.description}".strip()
            found.append((label == kind.apart != "", page.Image(as_url(picture), caption)))
    return [image for _, image in sorted(found, key=lambda each: each[0])]


def add_pattern_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options for patterns and the body that wears them."""
    own = parser.add_argument_group("sewn: patterns of one's own, instead of those that come with nuno")
    own.add_argument("--patterns", nargs="+", type=Path, default=[], metavar="PATTERN", help="as for nuno sew")
    add_flags(own, {
        "--body": ("FILE", "the body that wears each of them, by itself", Path),
        "--edge": ("LENGTH", "of the triangles' sides (default: 2 cm)", str),
        "--fabric": ("NAME", "a preset (default: interlock)", str),
    })  # fmt: skip
    parser.set_defaults(edge="2 cm", fabric="interlock")


def check_patterns(args: argparse.Namespace) -> None:
    """Raises BadInput for patterns without a body, a body without patterns, files that are not there or of one name."""
    if bool(args.patterns) != (args.body is not None):
        raise BadInput("patterns and a body belong together", field=NEEDED, remedy="give both, or none of them")
    if args.patterns and args.kind != "sewn":
        remedy = "nuno gallery sewn --patterns PATTERN... --body BODY"
        raise BadInput("patterns are sewn", field="--patterns", value=args.kind, remedy=remedy)
    for file in (*args.patterns, *([args.body] if args.body else [])):
        if not file.is_file():
            raise BadInput("no such file", field=NEEDED, value=str(file))
    names = [pattern.stem for pattern in args.patterns]
    if twice := [name for name in names if names.count(name) > 1]:
        raise BadInput("two patterns have one name", field="--patterns", value=twice[0], remedy="rename one")


def write_pattern_scenes(args: argparse.Namespace, folder: Path) -> dict[str, Path]:
    """A scene for each pattern, in a folder with copies of what they need, by name."""
    found = {}
    body = shutil.copy(args.body, folder / f"body{args.body.suffix}")
    for pattern in args.patterns:
        shutil.copy(pattern, folder)
        garments = [Garment(name_garments([pattern.stem])[0], pattern.name, args.fabric)]
        found[pattern.stem] = folder / f"{pattern.stem}-worn.yaml"  # a pattern may be YAML, too
        text = describe_worn(pattern.stem, garments, args.edge, Path(body).name)
        found[pattern.stem].write_text(text, encoding="utf-8")
    return found
