"""How Sphinx makes the site of these pages: `make docs`. The pages stay readable as they stand, on a code host too,
but for three of the reference, which are made here from the code.
"""

from __future__ import annotations

import re
import sys
from importlib.metadata import version as version_of
from pathlib import Path

from sphinx.application import Sphinx

# Imported before Sphinx documents any model: it writes annotations that it reads in pydantic's source onto pydantic's
# classes, after which pydantic makes no model that takes further fields.
import nuno_schemas.scene  # noqa: F401
from nuno.cli import reference

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "_extensions"))

for name in ("commands", "fields", "messages"):  # the pages that are made from the code
    page, text = HERE / "reference" / f"{name}.md", getattr(reference, f"describe_{name}")()
    if not page.is_file() or page.read_text(encoding="utf-8") != text:
        page.write_text(text, encoding="utf-8")

project = "nuno"
author = "nuno contributors"
copyright = "nuno contributors, Apache-2.0"
version = release = version_of("nuno")

extensions = ["myst_parser", "sphinx.ext.autodoc", "mathml", "plain_docstrings", "checks"]
exclude_patterns = ["_build"]
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 4  # as code hosts have them, so that a link to a heading leads there on both
autodoc_typehints_format = "short"
autodoc_member_order = "bysource"
maximum_signature_line_length = 88
autodoc_type_aliases = {name: name for name in ("Float", "Int", "Bool")}  # arrays of float64, integers, truth values
add_module_names = False
highlight_language = "none"  # of code that does not say what it is
smartquotes = False  # which would make one dash of the two of an option

html_theme = "furo"
html_title = f"nuno {version}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_copy_source = False
html_theme_options = {"source_repository": "", "top_of_page_buttons": []}
pygments_style, pygments_dark_style = "default", "github-dark"


def _contents(app: Sphinx, page: str, source: list[str]) -> None:
    """What an index links to in its lists is what lies below it: the table of contents is not written twice."""
    if page.rpartition("/")[2] == "index":
        below = re.findall(r"^- \[[^\]]*\]\(((?!\.\./)[^)#:]+)\.md\)", source[0], re.MULTILINE)
        source[0] += "\n\n```{toctree}\n:hidden:\n\n" + "\n".join(below) + "\n```\n"


def setup(app: Sphinx) -> None:
    """Called by Sphinx."""
    app.connect("source-read", _contents)
