"""A draft as weavers draw it: threading above, tie-up and treadling at the side, and the drawdown in yarns' colours.

A yarn is as wide as its file's spacing, if any, so that the drawdown has the cloth's proportions. Pick 1 is at the top
and end 1 at the left, as in pictures of cloth; shaft 1 and treadle 1 are next to the drawdown.
"""

from __future__ import annotations

import numpy as np

from nuno_dye.weaving_drafts.wif import Draft, Yarns, listed
from nuno_schemas.colour import to_linear, to_srgb
from nuno_schemas.fabric import Bool, Float, Int
from nuno_schemas.pictures import DrawnDraft, Picture

SIDE, LEAST_SIDE, MARGIN = 900, 480, 16
"""Approximate longer side of a picture, its least width, and its margin [pixels]."""
MOST_PITCH = 40
"""The most pixels per yarn."""
PAPER, LINES, MARK = 250, 205, 40
"""Greys of the ground, of grid lines, and of marked squares [sRGB bytes]."""
WARP, WEFT = (0.15, 0.15, 0.17), (0.96, 0.95, 0.92)
"""Colours of yarns of a file without any: drawn as weavers do, warp dark."""
RIM = 0.45
"""Share of linear light by which a yarn is darker at its rims than in its middle."""


def draw_draft(draft: Draft) -> DrawnDraft:
    """Return the picture of the whole draft, and facts in words."""
    loom, (picks, ends) = draft.loom, draft.drawdown.shape
    across, down = draft.warp.spacing, draft.weft.spacing
    treadle_count = loom.pressed.shape[1]
    pitch = float(np.clip(SIDE / max(ends + treadle_count, picks + loom.threading.shape[1]), 1, MOST_PITCH))
    pixel = None
    if across is not None and down is not None:
        pixel = float(np.concatenate([across, down]).mean()) / pitch
        columns, rows = (_edges(spacing / pixel) for spacing in (across, down))
    else:
        columns, rows = _edges(np.full(ends, pitch)), _edges(np.full(picks, pitch))
    unit = max(1, round(pitch))
    shafts, treadles = (_edges(np.full(number, float(unit))) for number in (loom.threading.shape[1], treadle_count))
    # Downwards threading, the warp's colours and drawdown; to the right drawdown, the weft's colours and treadling.
    (head, warp, body), (cloth, weft, treadling) = (
        _place_after(MARGIN, *lengths) for lengths in ((shafts[-1], unit, rows[-1]), (columns[-1], unit, treadles[-1]))
    )
    out = np.full((body.stop + MARGIN, max(treadling.stop + MARGIN, LEAST_SIDE), 3), PAPER, np.uint8)
    out[body, cloth] = draw_cloth(draft, rows, columns)
    out[head, cloth] = _grid(loom.threading.T[::-1], shafts, columns)
    out[body, treadling] = _grid(loom.pressed, rows, treadles)
    if loom.tie_up is not None:
        out[head, treadling] = _grid(loom.tie_up.T[::-1], shafts, treadles)
    out[warp, cloth] = _line(draft.warp, WARP, columns)[None]
    out[body, weft] = _line(draft.weft, WEFT, rows)[:, None]
    facts = {
        "ends": f"{ends}", "picks": f"{picks}", "shafts": f"{loom.threading.shape[1]}",
        "treadles": f"{treadle_count}" if loom.tie_up is not None else "a lift plan",
    }  # fmt: skip
    unsaid = [name for name, yarns in (("warp", across), ("weft", down)) if yarns is None]
    facts["size"] = f"not said: the file has no spacing of {' and '.join(unsaid)}"
    if across is not None and down is not None:
        facts["size"] = f"{1e3 * across.sum():.4g} mm x {1e3 * down.sum():.4g} mm"
    idle, empty = (np.flatnonzero(~used.any(axis=1)) + 1 for used in (loom.threading, loom.moved))
    for name, of, which, numbers in (
        ("on no shaft", "end", "which never rise", idle), ("without shafts", "pick", "at which no shaft moves", empty),
    ):  # fmt: skip
        if len(numbers):
            plural = "s" if len(numbers) > 1 else ""
            facts[name] = f"{len(numbers)} {of}{plural}, {which}: {listed(numbers.tolist())}"
    colourless = [name for name, yarns in (("warp", draft.warp), ("weft", draft.weft)) if yarns.colourless]
    if colourless:
        facts["colours"] = f"the file numbers those of {' and '.join(colourless)}, but has no [COLOR TABLE]: left out"
    if draft.left_out:
        facts["left out"] = "; ".join(draft.left_out)
    return DrawnDraft(out, pixel, facts, draft.drawdown)


def _place_after(start: int, *lengths: int) -> tuple[slice, ...]:
    """Return consecutive slices of these lengths, half of the second length apart."""
    apart, parts = max(1, int(lengths[1]) // 2), []
    for length in lengths:
        parts.append(slice(start, start + int(length)))
        start += int(length) + apart
    return tuple(parts)


def draw_cloth(draft: Draft, rows: Int, columns: Int) -> Picture:
    """Return the drawdown (h, w, 3) sRGB: each crossing in the colour of the yarn above, shaded across it."""
    picks, ends = draft.drawdown.shape
    colours = (_colours(draft.weft, WEFT, picks), _colours(draft.warp, WARP, ends))
    row, column = _yarn_of(rows), _yarn_of(columns)
    weft, warp = (
        _bytes(to_srgb(to_linear(colour[yarn]) * (1.0 - RIM * np.square(np.square(_across(edges, yarn))))[:, None]))
        for colour, yarn, edges in ((colours[0], row, rows), (colours[1], column, columns))
    )
    return np.where(draft.drawdown[np.ix_(row, column)][..., None], warp[None], weft[:, None])


def _edges(pitches: Float) -> Int:
    """Return the pixels (n + 1,) at which yarns begin and end, at least one for each."""
    edges = np.rint(np.concatenate([[0.0], np.cumsum(pitches)])).astype(np.int64)
    n = np.arange(len(edges))
    return np.asarray(np.maximum.accumulate(edges - n) + n)


def _yarn_of(edges: Int) -> Int:
    """Return the yarn (pixels,) of each pixel."""
    return np.repeat(np.arange(len(edges) - 1), np.diff(edges))


def _across(edges: Int, yarn: Int) -> Float:
    """Return places (pixels,) in [-1, 1] across yarns."""
    width = np.diff(edges)[yarn]
    return np.asarray((2.0 * (np.arange(len(yarn)) - edges[yarn]) + 1.0) / width - 1.0)


def _colours(yarns: Yarns, default: tuple[float, ...], number: int) -> Float:
    return np.tile(np.array(default), (number, 1)) if yarns.colour is None else yarns.colour


def _line(yarns: Yarns, default: tuple[float, ...], edges: Int) -> Picture:
    """Return sRGB (pixels, 3) of yarns side by side."""
    return _bytes(_colours(yarns, default, len(edges) - 1)[_yarn_of(edges)])


def _bytes(colours: Float) -> Picture:
    return np.rint(255.0 * colours).astype(np.uint8)


def _grid(marks: Bool, rows: Int, columns: Int) -> Picture:
    """Return a grey (h, w, 1) grid with some squares marked, with lines between them if there is room."""
    row, column = _yarn_of(rows), _yarn_of(columns)
    grey = np.where(marks[np.ix_(row, column)], MARK, PAPER)
    if min(np.diff(rows).min(), np.diff(columns).min()) >= 4:
        grey[rows[:-1]] = grey[:, columns[:-1]] = LINES
        grey[-1] = grey[:, -1] = LINES
    return grey[..., None].astype(np.uint8)
