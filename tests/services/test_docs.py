"""The documentation: links, generated pages of the reference, and the site."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from urllib.parse import unquote

import pytest

from nuno import cli
from nuno.cli import reference
from nuno.plugin_contract import registry
from nuno.scene.json_schema import PLACES
from nuno_bench.cli import COMMANDS

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
REFERENCE = DOCS / "reference"
MADE = {REFERENCE / f"{name}.md": name for name in ("commands", "fields", "messages")}
"""Pages that are made with the site."""
SITE = sorted({*DOCS.rglob("*.md"), *MADE})
PAGES = [*sorted(ROOT.glob("*.md")), ROOT / "deploy" / "README.md", *SITE]
PICTURES = {path for suffix in ("png", "svg", "gif", "jpg") for path in DOCS.rglob(f"*.{suffix}")}
LINK = re.compile(r"!?\[(?:[^\[\]]|!?\[[^\]]*\](?:\([^)]*\))?)*\]\(([^)\s]+)(?:\s+\"[^\"]*\")?\)")
INNER = re.compile(r"!\[[^\]]*\]\(([^)\s]+)\)")


@cache
def read(page: Path) -> str:
    return str(getattr(reference, f"describe_{MADE[page]}")()) if page in MADE else page.read_text(encoding="utf-8")


def prose(page: Path) -> str:
    """A page without its code."""
    text = re.sub(r"^(```+|~~~+).*?^\1", "", read(page), flags=re.MULTILINE | re.DOTALL)
    return re.sub(r"`[^`\n]*`", "`code`", text)


def links(page: Path) -> Iterator[tuple[Path, str]]:
    """The file and the anchor of each relative link; the page itself for one within it."""
    text = prose(page)
    for target in [*LINK.findall(text), *INNER.findall(text)]:
        if "://" not in target and not target.startswith("mailto:"):
            name, _, anchor = unquote(target).partition("#")
            yield (page.parent / name).resolve() if name else page, anchor


def anchors(page: Path) -> set[str]:
    """Of each heading, as code hosts make them: lower case, blanks to dashes, no signs, a number where it repeats."""
    text = re.sub(r"^(```+|~~~+).*?^\1", "", read(page), flags=re.MULTILINE | re.DOTALL)
    found: set[str] = set()
    for heading in re.findall(r"^#{1,6} +(.+?) *#*$", text, re.MULTILINE):
        plain = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", heading).replace("`", "")
        name = re.sub(r"[^\w\- ]", "", plain.lower()).replace(" ", "-")
        found.add(next(one for one in (name, *(f"{name}-{i}" for i in range(1, 100))) if one not in found))
    return found


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_link_leads_somewhere(page: Path) -> None:
    broken = [
        f"{file}#{anchor}"
        for file, anchor in links(page)
        if not (file in MADE or file.exists()) or (anchor and file.suffix == ".md" and anchor not in anchors(file))
    ]
    assert broken == []


@pytest.mark.parametrize("page", SITE, ids=lambda page: str(page.relative_to(DOCS)))
def test_a_page_of_the_site_stays_within_it(page: Path) -> None:
    assert [str(file) for file, _ in links(page) if not file.is_relative_to(DOCS)] == []


def test_every_picture_is_shown() -> None:
    shown = {file for page in PAGES for file, _ in links(page)}
    assert sorted(str(path.relative_to(ROOT)) for path in PICTURES - shown) == []


def test_every_page_is_found_from_the_first() -> None:
    """By links that indexes list, which are the site's contents."""
    found, ahead = set[Path](), [DOCS / "index.md"]
    while ahead:
        page = ahead.pop()
        found.add(page)
        listed = re.findall(r"^- \[[^\]]*\]\(([^)#:]+\.md)\)", read(page), re.MULTILINE)
        ahead += [file for name in listed if (file := (page.parent / name).resolve()) not in found]
    assert sorted(str(page.relative_to(ROOT)) for page in set(SITE) - found) == []


SOURCES = [ROOT / place for place in ("", "plugins", "services", "schemas", "bench", "tests")]
FILE = re.compile(
    r"(?<![\w./-])((?:nuno\w*|schemas|services|plugins|bench|tests|scenes|deploy|docs)/[\w./-]*\.[a-z0-9]+)\b"
)
MODULE = re.compile(r"(?<![\w./@-])(nuno_\w*(?:\.[A-Za-z_]\w*)+)")
"""In nuno's own packages; names that begin with `nuno.` are also those of groups, messages and the API."""


def stale(text: str) -> set[str]:
    """Paths of the source and names of modules, and of what is in them, that a text has and the project has not."""
    lost = {name for name in FILE.findall(text) if not any((place / name).exists() for place in SOURCES)}
    for name in MODULE.findall(text):
        parts = name.split(".")
        paths = [
            (path, parts[length:]) for length in range(len(parts), 0, -1) for place in SOURCES
            for base in [place.joinpath(*parts[:length])] for path in (base.with_suffix(".py"), base / "__init__.py")
            if path.is_file()
        ]  # fmt: skip
        if not paths or (paths[0][1] and not re.search(rf"\b{paths[0][1][0]}\b", paths[0][0].read_text())):
            lost.add(name)
    return lost


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_paths_and_names_of_the_source_are_there(page: Path) -> None:
    """The changelog tells what was, too."""
    if page.name != "CHANGELOG.md":
        assert not stale(read(page))


def test_stale_paths_and_names_are_seen() -> None:
    text = "`nuno_kernels/constraints.py`, `nuno_kernels/forces/constraints.py`, `nuno_schemas.plugin.Config`"
    assert stale(f"{text}, `nuno_schemas.plugin.Konfig`, `nuno_schemas.plug`, `nuno_kernels.terms.register`") == {
        "nuno_kernels/constraints.py", "nuno_schemas.plugin.Konfig", "nuno_schemas.plug",
    }  # fmt: skip


def test_broken_links_are_seen(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("# A `b` c, d\n\n[x](#a-b-c-d) [![y](no.png)](gone.md) `[z](code)`\n\n```\n[z](code)\n```\n")
    assert anchors(page) == {"a-b-c-d"}
    assert {(file.name, anchor) for file, anchor in links(page)} == {
        ("page.md", "a-b-c-d"), ("no.png", ""), ("gone.md", "")
    }  # fmt: skip


@pytest.mark.parametrize("name", ["fields", "commands"])
def test_each_field_and_argument_has_a_meaning(name: str) -> None:
    rows = [line for line in read(REFERENCE / f"{name}.md").splitlines() if line[:3] == "| `"]
    assert len(rows) > 100 and [row for row in rows if not row.rstrip("| ").rpartition(" | ")[2].strip("` ")] == []
    assert [row for row in rows if re.search(r"\| +\|$", row)] == []


def test_every_plugin_of_a_scene_has_its_fields() -> None:
    """A section for each, and in it a row for each field of its Config."""
    sections = re.split(r"^#{2,4} ", read(REFERENCE / "fields.md"), flags=re.MULTILINE)
    for group in set(PLACES.values()):
        for name in registry.installed(group):
            rows = [set(re.findall(r"^\| `(\w+)` \|", text, re.MULTILINE)) for text in sections
                    if text.startswith(f"{name} (")]  # fmt: skip
            fields = {field.alias or key for key, field in registry.load(group, name).Config.model_fields.items()}
            assert any(fields <= found for found in rows), (group, name)


def test_every_command_is_there() -> None:
    found = set(re.findall(r"^##+ nuno (.+)$", read(REFERENCE / "commands.md"), re.MULTILINE))
    assert found == {*cli.COMMANDS, *(f"bench {kind}" for kind in COMMANDS)}


def test_defaults_are_written_out() -> None:
    """In whichever of argparse's formats they stand."""
    text = read(REFERENCE / "commands.md")
    assert "%(" not in text and "%%" not in text and "(default: 60)" in text


HELD = re.compile(r"<(?:script|link|img|iframe|source|video)\b[^>]*?\b(?:src|href)=\"([^\"]+)\"")
"""What a browser fetches by itself."""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("sphinx")
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", str(DOCS), str(folder)]
    path = os.pathsep.join([*(str(ROOT / name) for name in ("schemas", "services", "plugins", "bench")), *sys.path])
    ended = subprocess.run(command, capture_output=True, text=True, env=os.environ | {"PYTHONPATH": path})
    assert (ended.returncode, ended.stderr) == (0, ""), ended.stderr
    return folder


@pytest.mark.full
def test_each_page_is_there_and_fetches_nothing_from_other_hosts(site: Path) -> None:
    for page in SITE:
        text = (site / page.relative_to(DOCS).with_suffix(".html")).read_text(encoding="utf-8")
        fetched = HELD.findall(text)
        assert fetched and [name for name in fetched if re.match(r"[a-z]+:|//", name)] == []
    for style in site.rglob("*.css"):
        assert re.findall(r"(?:url\(|@import)\s*[\"']?(?:https?:)?//", style.read_text(encoding="utf-8")) == []


@pytest.mark.full
def test_the_reference_holds_docstrings(site: Path) -> None:
    import nuno
    from nuno_testing.checks import OWN

    text = (site / "reference" / "python.html").read_text(encoding="utf-8")
    assert all(f'id="nuno.{name}"' in text for name in nuno.__all__)
    text = (site / "reference" / "protocols.html").read_text(encoding="utf-8")
    assert all(f">{check.__name__.replace('_', ' ')}<" in text for checks in OWN.values() for check in checks)


@pytest.mark.full
def test_formulas_are_drawn_by_the_browser(site: Path) -> None:
    """Each of a page's formulas is MathML, and none is left as it was written."""
    source = (DOCS / "explanation" / "methods.md").read_text(encoding="utf-8")
    text = (site / "explanation" / "methods.html").read_text(encoding="utf-8")
    blocks = source.count("$$") // 2
    assert blocks > 10 and text.count('display="block"') == blocks
    assert text.count("<math") == blocks + len(re.findall(r"\$[^$]+\$", source.replace("$$", "")))
    assert "$" not in re.sub(r"<(code|script|style)\b.*?</\1>", "", text, flags=re.DOTALL)
