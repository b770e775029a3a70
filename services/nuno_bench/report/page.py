"""A report as one HTML file: nothing external, readable on a phone, printable like a page of a paper.

The caller passes plain text, which is escaped here, and words between backticks set as code; only figures are markup
(SVG from `plots`). A table that is wider than the text takes what the window has, and scrolls in its own box beyond
that; on paper its type is smaller and its words wrap.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape

BAD = frozenset({"failed", "missed", "diverged", "contradicts"})
GOOD = frozenset({"bar met", "aim met", "agrees"})
"""Words that are coloured where a cell begins with them."""
LONG = 26
"""Cells with more characters than this wrap."""
MANY = 8
"""Tables with more columns than this are set smaller on paper."""

STYLE = """
:root { --ink: #1b1d21; --soft: #5b616b; --rule: #d9dce1; --bad: #a3262a; --good: #22663a; --paper: #fff; }
@media (prefers-color-scheme: dark) and (not print) {
  :root { --ink: #e4e6ea; --soft: #9ba2ad; --rule: #3a3f47; --bad: #ff8f8a; --good: #7fd19b; --paper: #15171a; }
  figure svg { background: #fff; border-radius: 4px; }
}
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 2.5rem 1.25rem 4rem; max-width: 59rem; background: var(--paper); color: var(--ink);
  font: 17px/1.55 Charter, "Bitstream Charter", "Source Serif 4", Georgia, "DejaVu Serif", serif; }
h1 { font-size: 1.75rem; line-height: 1.2; margin: 0 0 .4rem; font-weight: 600; }
h2 { font-size: 1.15rem; margin: 2.2rem 0 .5rem; font-weight: 600; }
p { margin: .6rem 0; max-width: 42rem; }
.lead { color: var(--soft); margin-bottom: 1.6rem; }
.wide { overflow-x: auto; margin: 0 0 .8rem; }
table { border-collapse: collapse; width: 100%; font-size: .8rem; line-height: 1.4;
  border-top: 1.5px solid var(--ink); border-bottom: 1.5px solid var(--ink); font-variant-numeric: tabular-nums; }
.table { position: relative; left: 50%; transform: translateX(-50%); width: max-content; min-width: 100%;
  max-width: calc(100vw - 2.5rem); background: linear-gradient(to right, var(--paper) 30%, transparent) left,
  linear-gradient(to left, var(--paper) 30%, transparent) right, linear-gradient(to right, var(--rule), transparent)
  left, linear-gradient(to left, var(--rule), transparent) right; background-repeat: no-repeat;
  background-size: 3rem 100%, 3rem 100%, 1rem 100%, 1rem 100%; background-attachment: local, local, scroll, scroll; }
.caption, figcaption { color: var(--soft); font-size: .85rem; padding: .35rem 0; max-width: 42rem; }
.caption { margin: .8rem 0 0; }
th { text-align: left; font-weight: 600; border-bottom: .75px solid var(--ink); vertical-align: bottom; }
th, td { padding: .32rem .65rem .32rem 0; }
th:last-child, td:last-child { padding-right: 0; }
td, th { white-space: nowrap; }
td.long, .prose td { white-space: normal; min-width: 9rem; }
.prose td.bad, .prose td.good { white-space: nowrap; min-width: 0; }
td { vertical-align: top; border-bottom: .5px solid var(--rule); }
tr:last-child td { border-bottom: 0; }
.number { text-align: right; white-space: nowrap; }
.bad { color: var(--bad); font-weight: 600; }
.good { color: var(--good); }
figure { margin: 1.4rem 0; }
figure svg { width: 100%; height: auto; display: block; }
.pictures { display: grid; grid-template-columns: repeat(auto-fill, minmax(15rem, 1fr)); gap: 1.2rem; }
.pairs { grid-template-columns: repeat(auto-fill, minmax(22rem, 1fr)); }
.pictures figure { margin: 0; }
.pictures img { width: 100%; height: auto; display: block; border-radius: 3px; }
dl { display: grid; grid-template-columns: max-content 1fr; gap: .15rem 1.2rem; font-size: .85rem; }
dt { color: var(--soft); } dd { margin: 0; overflow-wrap: anywhere; }
code { font: .88em ui-monospace, "DejaVu Sans Mono", Menlo, monospace; }
@media (max-width: 36rem) { body { font-size: 16px; padding-top: 1.5rem; } figure svg { min-width: 34rem; }
  dl { display: block; } dd { margin-bottom: .5rem; } }
@media print { body { font-size: 10.5pt; max-width: none; padding: 0; } h2 { break-after: avoid; }
  table { font-size: .72em; } table.many { font-size: .6em; } .caption { break-after: avoid; }
  td, th { white-space: normal; padding-right: .45rem; } td.long, .prose td { min-width: 0; }
  .table { position: static; transform: none; width: auto; max-width: none; background: none; }
  figure, tr { break-inside: avoid; } .wide { overflow: visible; } @page { margin: 18mm; } }
"""


@dataclass(frozen=True)
class Table:
    """headings, rows of text, and a sentence above them."""

    headings: Sequence[str]
    rows: Sequence[Sequence[str]]
    caption: str
    prose: bool = False
    """Whether cells are sentences, which wrap."""


@dataclass(frozen=True)
class Figure:
    """svg markup, and the sentence below it, which also describes it to those who do not see it."""

    svg: str
    caption: str


@dataclass(frozen=True)
class Image:
    """A picture as a data URL, and the sentence below it."""

    source: str
    caption: str


@dataclass(frozen=True)
class Pictures:
    """Pictures side by side, as many in a row as fit."""

    images: Sequence[Image]


@dataclass(frozen=True)
class Facts:
    """Names and values, e.g. the machine and the command."""

    values: Mapping[str, str]


Part = str | Table | Figure | Pictures | Facts
"""A paragraph of plain text, or one of the above."""


def render(title: str, lead: str, sections: Sequence[tuple[str, Sequence[Part]]]) -> str:
    """The whole page. Each section is a heading ("" for none) and its parts."""
    body = [f"<h1>{escape(title)}</h1>", f'<p class="lead">{escape(lead)}</p>']
    for heading, parts in sections:
        if heading:
            body.append(f"<h2>{escape(heading)}</h2>")
        body += [_part(part) for part in parts]
    head = '<meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">'
    head += f"<title>{escape(title)}</title><style>{STYLE}</style>"
    return f'<!doctype html>\n<html lang="en"><head>{head}</head>\n<body>\n' + "\n".join(body) + "\n</body></html>\n"


def _part(part: Part) -> str:
    if isinstance(part, Table):
        return _table(part)
    if isinstance(part, Figure):
        label, caption = escape(part.caption, quote=True), _text(part.caption)
        picture = f'<div class="wide" role="img" aria-label="{label}">{part.svg}</div>'
        return f"<figure>{picture}<figcaption>{caption}</figcaption></figure>"
    if isinstance(part, Pictures):
        kind = "pictures pairs" if len(part.images) in (2, 4) else "pictures"
        return f'<div class="{kind}">' + "".join(map(_image, part.images)) + "</div>"
    if isinstance(part, Facts):
        return "<dl>" + "".join(f"<dt>{escape(k)}</dt><dd>{escape(v)}</dd>" for k, v in part.values.items()) + "</dl>"
    return f"<p>{_text(part)}</p>"


def _text(text: str) -> str:
    """Escaped; what stands between backticks is code."""
    return re.sub(r"`([^`]+)`", r"<code>\1</code>", escape(text))


def _image(image: Image) -> str:
    label, caption = escape(image.caption, quote=True), _text(image.caption)
    return f'<figure><img src="{image.source}" alt="{label}"><figcaption>{caption}</figcaption></figure>'


def _table(table: Table) -> str:
    numeric = [all(_is_number(row[c]) for row in table.rows) for c in range(len(table.headings))]
    right = [' class="number"' if flag else "" for flag in numeric]
    head = "".join(f"<th{r}>{escape(name)}</th>" for name, r in zip(table.headings, right, strict=True))
    lines = ["".join(_cell(text, flag) for text, flag in zip(row, numeric, strict=True)) for row in table.rows]
    body = "".join(f"<tr>{line}</tr>" for line in lines)
    caption = f'<p class="caption">{_text(table.caption)}</p>'
    # Sentences wrap at the width of the text; numbers take what the window has.
    box = "wide" if table.prose else "wide table"
    names = ["prose"] if table.prose else []
    names += ["many"] if len(table.headings) > MANY else []
    kind = f' class="{" ".join(names)}"' if names else ""
    inner = f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody>"
    return f'{caption}<div class="{box}"><table{kind}>{inner}</table></div>'


def _cell(text: str, numeric: bool) -> str:
    names = ["number"] if numeric else []
    names += ["long"] if len(text) > LONG else []
    names += ["bad"] if _begins(text, BAD) else ["good"] if _begins(text, GOOD) else []
    return f'<td class="{" ".join(names)}">{_text(text)}</td>' if names else f"<td>{_text(text)}</td>"


def _begins(text: str, words: frozenset[str]) -> bool:
    return any(text == word or text.startswith((word + " ", word + ",")) for word in words)


def _is_number(text: str) -> bool:
    return (
        text == "" or text[0] in "-+<>=.0123456789\N{MINUS SIGN}\N{LESS-THAN OR EQUAL TO}\N{GREATER-THAN OR EQUAL TO}"
    )
