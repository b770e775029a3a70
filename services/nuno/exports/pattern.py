"""Export of the flat pattern of sewn garments as a drawing at true size: SVG, 1 unit = 1 mm, or a PDF made from it."""

from __future__ import annotations

from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from nuno.collision.bodies import outlines
from nuno.exports.cloth import STRETCH, Pieces, ShownPiece, as_url, check_size, paint_stretch, read_frame
from nuno.output_files import check_target, load_extra, writing
from nuno.recording.reader import Recording, opened
from nuno_schemas.colour import colours, to_srgb
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Corners, Float, Int, Panels

# Words, numbers and scales on the drawing of a flat pattern.

STRIPES = 50
"""Number of stripes of the bar of strains."""
INK, SEAM = "#1d2430", "#b5523b"


def scale() -> list[str]:
    """Return a scale of 10 cm for checking prints."""
    return [
        f'<path class="scale" d="M0,-3V3M0,0H100M100,-3V3" fill="none" stroke="{INK}" stroke-width="0.6"/>',
        text("10 cm", 50, -2.5, 6, INK, "middle"), text("1:1, in mm. Arrows run along the warp.", 0, 12, 5),
    ]  # fmt: skip


def legend(words: str) -> list[str]:
    """Return a colour bar of 100 mm next to the scale, with the strains at decades."""
    # Stripes, since the PDF converter supports no gradients. Each extends under the next, so that no gap is visible.
    inks, wide = as_hex(colours(np.arange(STRIPES), 0.0, STRIPES - 1.0)), 100.0 / STRIPES
    decades = np.arange(round(np.log10(STRETCH[0])), round(np.log10(STRETCH[1])) + 1).tolist()
    marks = np.linspace(130.0, 230.0, len(decades)).tolist()
    return [
        *(f'<rect x="{130 + k * wide:g}" y="-3" width="{100 - k * wide:g}" height="6" fill="{ink}"/>'
          for k, ink in enumerate(inks)),
        text(words, 130, -5.5, 5),
        *(text(f"{100.0 * 10.0**k:g} %", x, 9, 5, INK, "middle") for k, x in zip(decades, marks, strict=True)),
    ]  # fmt: skip


def points(rows: Float) -> str:
    return " ".join(f"{x:.3f},{y:.3f}" for x, y in rows.tolist())


def text(text: str, x: float, y: float, size: float, ink: str = INK, anchor: str = "start") -> str:
    place = f'x="{x:.3f}" y="{y:.3f}" font-size="{size:.3g}" fill="{ink}" text-anchor="{anchor}"'
    # A white outline first: labels must be readable on any colour, and not all programs support paint-order.
    return f'<text {place} stroke="#ffffff" stroke-width="{0.2 * size:.3g}">{escape(text)}</text>' + (
        f"<text {place}>{escape(text)}</text>"
    )


MM, PLAIN = 1e3, "#d9d4c8"
GAP, MARGIN, HEAD, FOOT = 30.0, 20.0, 14.0, 40.0
"""Space between panels, around the drawing, for a garment's name above it, for scale and legend below it [mm]."""
NOTCH, INSIDE = 5.0, 10.0
"""Length of a notch, and distance of its label from the edge [mm]."""
WORDS = {"stretch": "largest strain", "warp": "strain along the warp", "weft": "strain along the weft"}
"""Quantities by which triangles can be painted, with their legends."""


def export_pattern(source: Recording | Path | str, path: Path, frame: int | None = None, colour: str = "auto") -> Path:
    """Draw the panels of all sewn garments, garment next to garment, as .svg or .pdf at true size.

    colour "stretch", "warp" or "weft" paints triangles by the strain of a frame (default: the last), "cloth" shows the
    print of the panels, or the garment's colour; any other draws outlines. Raises BadInput for another ending, a
    missing frame, a recording without a sewn garment, a .pdf of a print, and a .pdf if fpdf2 is not installed.
    """
    suffix = ".pdf" if path.suffix.lower() == ".pdf" else ".svg"
    check_target(path, suffix)
    if suffix == ".pdf":
        _fpdf()
    with opened(source) as recording:
        shown = read_frame(recording, frame)
        pieces = Pieces(recording).at(shown.t)
        check_size(recording, pieces, shown)
        garments = [(p, p.corners, p.corners.panels) for p in pieces if p.corners is not None and p.corners.panels]
        if not garments:
            problem, remedy = (
                "no garment is sewn from a pattern",
                "give an object the model pattern: see docs/how-to/sewing.md",
            )
            raise BadInput(problem, str(recording.path), field="--pattern", value=str(path), remedy=remedy)
        if suffix == ".pdf" and colour == "cloth" and any(piece.image is not None for piece, _, _ in garments):
            # fpdf2 does not clip images: each panel would show the whole print.
            raise BadInput("a PDF cannot show a print within its panels", field="--pattern", value=str(path),
                           remedy="export an .svg, which browsers print at true size")  # fmt: skip
        elements, start, height = list[str](), MARGIN, 0.0
        for piece, corners, panels in garments:
            flat, width = _lay(corners, panels)
            height = max(height, float(flat[:, 1].max()))
            x, painted = shown.x[piece.start : piece.stop], None
            if colour in WORDS:
                painted = as_hex(paint_stretch(strains(piece, x)[colour]))
            elements.append(f'<g class="garment" transform="translate({start:.3f} 0)">')
            elements.append(text(piece.name, 0.0, -float(flat[:, 1].max()) - 6.0, 8.0))
            cloth = _cloth(piece, flat, corners, panels) if colour == "cloth" else None
            elements += _garment(piece.name, corners, panels, flat * [1.0, -1.0], painted, cloth)
            elements.append("</g>")
            start += width + 2.0 * GAP
        foot = [*scale(), *(legend(WORDS[colour]) if colour in WORDS else [])]
    width, top = max(start - 2.0 * GAP + MARGIN, 2.0 * MARGIN + 260.0), MARGIN + HEAD
    size = f"{width:.3f}", f"{top + height + FOOT + MARGIN:.3f}"
    lines = [
        f'<svg id="nuno-pattern" xmlns="http://www.w3.org/2000/svg" width="{size[0]}mm" height="{size[1]}mm" '
        f'viewBox="0 0 {size[0]} {size[1]}" font-family="sans-serif" stroke-linejoin="round">',
        '<rect width="100%" height="100%" fill="#ffffff"/>',
        f'<g transform="translate(0 {top + height:.3f})">', *elements, "</g>",
        f'<g transform="translate({MARGIN} {top + height + 20.0:.3f})">', *foot, "</g>", "</svg>",
    ]  # fmt: skip
    with writing(path, suffix) as new:
        if suffix == ".pdf":
            fpdf = _fpdf()
            drawing = fpdf.svg.SVGObject("\n".join(lines))
            page = fpdf.FPDF(unit="pt", format=(drawing.width, drawing.height))
            page.set_auto_page_break(False)
            page.add_page()
            drawing.draw_to_page(page)
            page.output(str(new))
        else:
            new.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def _fpdf() -> Any:
    return load_extra(("fpdf", "fpdf.svg"), "PDF needs fpdf2", "pdf", "export an .svg")


def _cloth(piece: ShownPiece, flat: Float, corners: Corners, panels: Panels) -> list[str]:
    """Return the fill of each panel's outline: the print as an SVG element, else the colour."""
    if piece.image is None:
        return [piece.colour or PLAIN] * len(panels.names)
    data, fills = as_url(piece.image), []
    for k, unit in enumerate(panels.unit.tolist()):
        corner = int(corners.faces[panels.of == k][0, 0])
        side = MM * unit
        x, y = flat[corner] - side * corners.points[corner].astype(np.float64)
        fills.append(
            f'<image x="{x:.3f}" y="{-y - side:.3f}" width="{side:.3f}" height="{side:.3f}" preserveAspectRatio="none" '
            f'href="{data}"/>'
        )
    return fills


def strains(piece: ShownPiece, x: Float) -> dict[str, Float]:
    """Return the largest strain of each triangle at x (n, 3) [m], and those along warp and weft, by the names in WORDS,
    as `nuno fit` measures them; NaN for triangles without a panel.
    """
    if piece.corners is None or piece.corners.panels is None:
        raise ValueError("strain is measured from panels")
    unit = np.append(piece.corners.panels.unit, np.nan)[piece.corners.panels.of]
    flat = piece.corners.points.astype(np.float64)[piece.corners.faces] * unit[:, None, None]
    (u0, v0), (u1, v1) = (flat[:, 1] - flat[:, 0]).T, (flat[:, 2] - flat[:, 0]).T
    a, b, c = np.take(x, piece.faces.T, axis=0)
    twice = (u0 * v1 - u1 * v0)[:, None]
    weft = (v1[:, None] * (b - a) - v0[:, None] * (c - a)) / twice
    warp = (u0[:, None] * (c - a) - u1[:, None] * (b - a)) / twice
    ww, ff, wf = ((one * other).sum(axis=1) for one, other in ((warp, warp), (weft, weft), (warp, weft)))
    most = np.sqrt(0.5 * (ww + ff) + np.hypot(0.5 * (ww - ff), wf))
    return {"stretch": most - 1.0, "warp": np.sqrt(ww) - 1.0, "weft": np.sqrt(ff) - 1.0}


def as_hex(linear: Float) -> list[str]:
    """Return colours of linear light (n, 3) as "#rrggbb"."""
    return ["#" + bytes(row).hex() for row in np.rint(255.0 * to_srgb(linear)).astype(np.uint8)]


def _lay(corners: Corners, panels: Panels) -> tuple[Float, float]:
    """Return the corners (p, 2) [mm] with the warp upwards and panels side by side, and the total width."""
    flat, start = np.zeros((len(corners.points), 2)), 0.0
    for k, unit in enumerate(panels.unit.tolist()):
        used = np.unique(corners.faces[panels.of == k])
        points = MM * unit * corners.points[used].astype(np.float64)
        flat[used] = points - points.min(axis=0) + [start, 0.0]
        start = float(flat[used, 0].max()) + GAP
    return flat, start - GAP


def _garment(
    piece: str, corners: Corners, panels: Panels, flat: Float, painted: list[str] | None, cloth: list[str] | None
) -> list[str]:
    """Return the SVG elements of a garment with corners at flat (p, 2), y down."""
    lines = []
    for k, name in enumerate(panels.names):
        which = np.flatnonzero(panels.of == k)
        faces = corners.faces[which]
        lines.append(f'<g class="panel" data-name="{escape(name)}">')
        if painted is not None:
            for number in which.tolist():
                ink, places = painted[number], points(flat[corners.faces[number]])
                lines.append(f'<polygon points="{places}" fill="{ink}" stroke="{ink}" stroke-width="0.15"/>')
        loops = [_without_slits(loop, corners.vertex, panels.pairs) for loop in outlines(faces)]
        path = " ".join(f"M{points(flat[loop])}Z" for loop in loops)
        if cloth is not None:
            lines += _filled(cloth[k], path, f"cut-{piece}-{k}")
        lines += [f'<path class="outline" d="{path}" fill="none" stroke="{INK}" stroke-width="0.6"/>']
        lines += [*_grain(name, flat[faces]), "</g>"]
    # An end of a closed short side may be in no triangle.
    used = np.isin(panels.pairs, corners.faces).all(axis=1)
    for number in np.unique(panels.seam).tolist():
        pairs = panels.pairs[(panels.seam == number) & used]
        for side in pairs.T if len(pairs) > 1 else ():
            lines += _seam(panels.letters(number), flat, side, corners.faces)
    return lines


def _filled(cloth: str, path: str, clip: str) -> list[str]:
    """Return a panel's outline filled with a colour, or as the clip path of this name with an element."""
    if not cloth.startswith("<"):
        return [f'<path class="cloth" d="{path}" fill="{cloth}"/>']
    return [f'<clipPath id="{clip}"><path d="{path}"/></clipPath>', f'<g clip-path="url(#{clip})">{cloth}</g>']


def _without_slits(loop: list[int], vertex: Int, pairs: Int) -> list[int]:
    """Return an outline without points whose two neighbours are one vertex but not sewn: there a short side was closed,
    and its triangle left out.
    """
    sewn = {frozenset(pair) for pair in pairs.tolist()}

    def is_slit(k: int) -> bool:
        one, other = loop[k - 1], loop[(k + 1) % len(loop)]
        return one != other and vertex[one] == vertex[other] and frozenset((one, other)) not in sewn

    return [point for k, point in enumerate(loop) if not is_slit(k)]


def _seam(letters: str, flat: Float, side: Int, faces: Int) -> list[str]:
    """Return a sewn edge, with a notch at its middle and the letters of the seam."""
    run = flat[side]
    along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(run, axis=0), axis=1)))
    middle = np.array([np.interp(0.5 * along[-1], along, axis) for axis in run.T])
    at = min(int(np.searchsorted(along, 0.5 * along[-1], side="right")), len(run) - 1)
    direction = run[at] - run[at - 1]
    inwards = np.array([-direction[1], direction[0]]) / np.linalg.norm(direction)
    touching = faces[(faces == side[at]).any(axis=1) | (faces == side[at - 1]).any(axis=1)]
    inwards *= np.sign((flat[touching].mean(axis=(0, 1)) - middle) @ inwards)
    tip, place = middle + NOTCH * inwards, middle + INSIDE * inwards
    return [
        f'<polyline class="seam" data-seam="{letters}" points="{points(run)}" fill="none" stroke="{SEAM}"/>',
        f'<path d="M{points(np.stack([middle, tip]))}" stroke="#ffffff" stroke-width="2.5"/>',
        f'<path d="M{points(np.stack([middle, tip]))}" stroke="{SEAM}"/>',
        text(letters, place[0], place[1] + 3.0, 8, SEAM, "middle"),
    ]


def _grain(name: str, corners: Float) -> list[str]:
    """Return the arrow of the warp, in the triangle nearest to the panel's centre, and the panel's name along it."""
    centres = corners.mean(axis=1)
    x, y = centres[np.argmin(np.linalg.norm(centres - centres.mean(axis=0), axis=1))]
    width, height = np.ptp(corners.reshape(-1, 2), axis=0)
    half, size = 0.2 * height, float(min(14.0, 0.3 * width, 0.6 * height / max(len(name), 1)))
    tip = min(8.0, half)
    head = f"m{-0.5 * tip:.3f},{tip:.3f}l{0.5 * tip:.3f},{-tip:.3f}l{0.5 * tip:.3f},{tip:.3f}"
    arrow = f"M{x:.3f},{y + half:.3f}V{y - half:.3f}{head}"
    return [
        f'<path d="{arrow}" fill="none" stroke="#ffffff" stroke-width="2"/>',
        f'<path class="grain" d="{arrow}" fill="none" stroke="{INK}" stroke-width="0.5"/>',
        f'<g transform="translate({x - 0.4 * size:.3f} {y:.3f}) rotate(-90)">',
        text(name, 0, 0, size, INK, "middle"),
        "</g>",
    ]
