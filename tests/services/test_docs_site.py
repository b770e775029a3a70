"""The site that `make docs` makes: without a warning, whole, and with nothing from other hosts."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
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
    for page in DOCS.rglob("*.md"):
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
