"""Mistakes in scenes: the page names each at the field, and in the words, of the command line and of Python."""

from __future__ import annotations

from pathlib import Path

import pytest
from browser import Page
from seeded_mistakes import NUMBER, Mistake, draw, write
from studio_desk import NEEDS_BROWSER, look_at_scene, studio

import nuno
from nuno.cli import main
from nuno.scene import scene_file
from nuno.studio import scenes
from nuno_schemas.errors import BadInput

BUILT = ("file", "body")
"""Kinds that the command line finds once it builds what the scene describes, which takes seconds."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("scenes")


@pytest.fixture(scope="module")
def mistakes(folder: Path) -> list[tuple[Mistake, Path]]:
    drawn = draw()
    return list(zip(drawn, write(drawn, folder), strict=True))


def test_there_are_fifty_of_many_kinds_in_many_scenes_and_without_them_they_are_right(
    mistakes: list[tuple[Mistake, Path]],
) -> None:
    assert len(mistakes) == NUMBER == 50
    assert len({one.kind for one, _ in mistakes}) >= 15 and len({one.scene for one, _ in mistakes}) >= 25
    assert len({one.text for one, _ in mistakes}) == NUMBER


def page_says(path: Path) -> dict[str, object]:
    """The first that the page is told of."""
    told = scenes.check(path.read_text(encoding="utf-8"), Path(path.name))["mistakes"]
    assert told, "the page finds nothing wrong"
    return dict(told[0])


def agree(mistakes: list[tuple[Mistake, Path]], capsys: pytest.CaptureFixture[str]) -> None:
    """All that two of page, command line and Python say otherwise, in one list."""
    wrong = []
    for mistake, path in mistakes:
        capsys.readouterr()
        code, page = main(["plan", path.name]), page_says(path)
        said = capsys.readouterr().err.strip()
        if (code, said) != (2, f"error: {page['words']}".strip()):
            wrong.append((mistake, "command line", said, page["words"]))
        with pytest.raises(BadInput) as refused:
            nuno.plan(path.name)
        error = refused.value
        found = (error.problem, error.field or "", error.line)
        if found != (page["problem"], page["field"], page["line"]):
            wrong.append((mistake, "Python", str(found), page["words"]))
    assert wrong == [], "\n".join(map(str, wrong))


def test_page_command_line_and_python_name_each_at_the_same_field(
    mistakes: list[tuple[Mistake, Path]], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(mistakes[0][1].parent)
    agree([one for one in mistakes if one[0].kind not in BUILT], capsys)


@pytest.mark.full
def test_so_they_do_those_that_are_found_when_it_is_built(
    mistakes: list[tuple[Mistake, Path]], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(mistakes[0][1].parent)
    agree([one for one in mistakes if one[0].kind in BUILT], capsys)


def test_a_run_from_python_and_a_scene_as_an_object_refuse_them_too(
    mistakes: list[tuple[Mistake, Path]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(mistakes[0][1].parent)
    for mistake, path in mistakes:
        if mistake.kind in BUILT:
            continue
        page = page_says(path)
        with pytest.raises(BadInput) as refused:
            nuno.Scene(path.name)
        assert (refused.value.problem, refused.value.line) == (page["problem"], page["line"]), mistake
        with pytest.raises(BadInput) as read:
            scene_file.read(Path(path.name))
        assert str(read.value) == page["words"], mistake


SEEN = """
[...document.querySelectorAll('.mistake')].map((box) => [
  box.closest('[data-path]')?.dataset.path ?? '', [...box.querySelectorAll('p:not(.place)')].map((p) => p.textContent),
  box.querySelector('.place')?.textContent ?? '', box.getClientRects().length > 0,
  box.parentElement.querySelector(':scope > .control > input') !== null])
"""
"""Of each mistake that is shown: its row, its words, its place in the text, whether it is seen, and whether its row has
all that its field holds on one line."""


@pytest.mark.full
@NEEDS_BROWSER
def test_the_page_shows_each_at_its_field(
    page: Page, mistakes: list[tuple[Mistake, Path]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(mistakes[0][1].parent)
    wrong = []
    with studio() as (_, server):
        for mistake, path in mistakes:
            told = page_says(path)
            look_at_scene(page, server, path.name)
            shown = page.value(SEEN)
            problem, *more = str(told["words"]).split("\n")
            words = [str(told["problem"]), *map(str.strip, more)]
            place = problem.removesuffix(f": {told['problem']}")
            first = next((one for one in shown if one[1] == words and one[2] == place), None)
            field = str(told["field"])
            if first is None or not first[3]:
                wrong.append((mistake.kind, mistake.scene, field, "is not shown", shown))
            elif field and first[0] != field and not (first[4] and field.startswith(first[0])):
                wrong.append((mistake.kind, mistake.scene, field, "stands at", first[0]))
    assert wrong == [], "\n".join(map(str, wrong))
