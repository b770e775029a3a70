"""The directive `checks`: what `nuno_testing.contract` looks at of each kind of plugin, from the checks themselves."""

from __future__ import annotations

from docutils import nodes
from docutils.statemachine import StringList
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from nuno_testing.checks import ALL, OWN


class Checks(SphinxDirective):
    """A kind, then each of its checks with its docstring."""

    def run(self) -> list[nodes.Node]:
        lines: list[str] = []  # Markdown, as the page around them
        for kind, checks in {"Every kind": ALL, **OWN}.items():
            lines += ["", f"**{kind}**" if kind not in OWN else f"`{kind}`", ""]
            for check in checks:
                said = " ".join((check.__doc__ or "").split()).replace("*", "\\*")
                lines += [f"- *{check.__name__.replace('_', ' ')}*: {said}"]
        found = nodes.container()
        self.state.nested_parse(StringList(lines, source="nuno_testing.checks"), self.content_offset, found)
        return found.children


def setup(app: Sphinx) -> dict[str, bool]:
    """Called by Sphinx."""
    app.add_directive("checks", Checks)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
