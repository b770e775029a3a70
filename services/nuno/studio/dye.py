"""Dye, paste and stencils painted on cloth with the mouse, as items of the scene.

A stroke becomes a supply `stroke`, or a resist `paste`: a line of points and a width. A mask of pixels would be less
exact and not readable, and a present run accepts strokes, but no new image. A stencil becomes a picture with a grey
value per cell, next to the scene, and the resist `image` that names it.
"""

from __future__ import annotations

import base64
import binascii
import io
import itertools
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from nuno.dye.run import build_cloth, parse
from nuno.dye.supply import Supplies
from nuno.exports.cloth import as_png
from nuno.scene import edit, yaml_lines
from nuno.scene.edit import flow
from nuno.scene.scene_file import Loaded
from nuno.studio import scenes
from nuno.studio.dropped_files import reserve
from nuno.studio.processes import Workshop
from nuno.studio.server import NOT_FOUND, Refused, whole
from nuno_schemas.colour import upright
from nuno_schemas.dye import Cells, DyeState, Supply
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float
from nuno_schemas.pictures import Picture, Window, amount_seen

UNREADABLE = (binascii.Error, UnidentifiedImageError, Image.DecompressionBombError, OSError, ValueError, SyntaxError)
"""Errors of data that are not a picture, or one that is too large to decode."""
OFF = 0.25
"""Largest distance of a written line from the drawn one, in cells."""
FINENESS, MOST_PIXELS = 4, 2**25
"""Pixels per cell, along each side, of a rasterised stencil, and the largest number of pixels."""
MOST_IMAGE = 4000
"""Largest side of a stencil [pixels]."""


def live_item_of(request: Mapping[str, Any], cells: Cells) -> str:
    """Return the item of a stroke of the page for the present run. Raises BadInput."""
    if request.get("tool") == "stencil":
        problem, remedy = "a run takes no new image, which its recording would lack", "stop it, and put it in the text"
        raise BadInput(problem, field="tool", remedy=remedy)
    return stroke_of(request, cells.size)


def item_of(request: Mapping[str, Any], cells: Cells, scene: Path, own: bool) -> tuple[str, Path | None]:
    """Return the item of a stroke or a stencil of the page, in the form of `nuno control add`, and the picture written
    for it. Raises BadInput.

    own  whether the scene is in the page's folder, into which pictures are written
    """
    if request.get("tool") != "stencil":
        return stroke_of(request, cells.size), None
    if not own:
        remedy = "save the scene under a name of yours first"
        raise BadInput("a stencil's picture is written beside the scene, which comes with nuno", remedy=remedy)
    return stencil_of(request, cells.fibre.shape[1:], cells.size, scene)


def stroke_of(request: Mapping[str, Any], cell: float) -> str:
    """Return the item of a stroke of the page, in the form of `nuno control add`. Raises BadInput.

    request  `tool` dye or paste, `points` [m] and `width` [m]; for dye also `dye`, its name, and `amount`
    cell     side of a cell [m]
    """
    points = np.array(request.get("points"), np.float64) if _numbers(request.get("points")) else np.zeros((0, 2))
    width = request.get("width")
    if not (points.ndim == 2 and points.shape[1:] == (2,) and len(points) and np.isfinite(points).all()):
        raise BadInput("a stroke has points", field="points", limit="pairs of x and y [m]")
    if not (isinstance(width, int | float) and 0.0 < width < math.inf):
        raise BadInput("a brush has a width", field="width", value=width, limit="above 0 [m]")
    line = ", ".join(f"[{_length(x, cell)}, {_length(y, cell)}]" for x, y in simplified(points, OFF * cell).tolist())
    rest = f"points: [{line}], width: {_length(float(width), cell)}"
    if request.get("tool") == "paste":
        return f"resist: {{kind: paste, {rest}}}"
    amount = request.get("amount")
    if type(amount) not in (int, float):
        raise BadInput("a brush has an amount of dye", field="amount", value=amount, limit="0 to 1")
    return f"supply: {{kind: stroke, dye: {flow(str(request.get('dye')))}, {rest}, amount: {amount:.3g}}}"


def _numbers(points: object) -> bool:
    """Return whether these are pairs of numbers; NumPy would convert other values."""
    return isinstance(points, list) and all(
        isinstance(one, list) and len(one) == 2 and all(type(value) in (int, float) for value in one) for one in points
    )


def _length(metres: float, cell: float) -> str:
    """Return a length in mm as text, to a hundredth of a cell."""
    digits = max(0, 2 - math.floor(math.log10(cell * 1e3)))
    text = f"{round(metres * 1e3, digits) + 0.0:.{digits}f}"
    return f"{text.rstrip('0').rstrip('.') if digits else text} mm"


def simplified(points: Float, off: float) -> Float:
    """Return some of a line's points (n, 2), shape (m, 2), with both ends, such that no other point is farther than
    `off` from their line (Douglas and Peucker 1973).
    """
    keep = np.zeros(len(points), np.bool_)
    keep[[0, -1]] = True
    spans = [(0, len(points) - 1)]
    while spans:
        first, last = spans.pop()
        between = points[first + 1 : last]
        if not len(between):
            continue
        start, along = points[first], points[last] - points[first]
        long = float(along @ along)
        share = np.clip((between - start) @ along / long, 0.0, 1.0) if long > 0.0 else np.zeros(len(between))
        away = np.hypot(*(between - start - share[:, None] * along).T)
        if (most := int(away.argmax())) >= 0 and away[most] > off:
            keep[first + 1 + most] = True
            spans += [(first, first + 1 + most), (first + 1 + most, last)]
    return np.asarray(points[keep])


def put(text: str, item: str, file: str) -> str:
    """Return the scene's text with one more supply or resist. Raises BadInput."""
    key, fields = parse(item)
    data, _ = yaml_lines.parse(text, file)
    items = data.get("dye", {}).get("cloth", {}).get(key) or []
    written = item.split(":", 1)[1].strip()
    return edit.put(text, ("dye", "cloth", key, len(items)), fields, file, written)


def stencil_of(request: Mapping[str, Any], shape: Sequence[int], cell: float, scene: Path) -> tuple[str, Path]:
    """Return the item of a stencil of the page, and its picture, which is written next to the scene. Raises BadInput.

    request  `image`, a PNG in base64 in which white keeps dye out, or black with `invert`; its centre `place` [m] and
             its `width` [m]
    shape    (ny, nx) of the cloth
    """
    if not (_numbers([request.get("place")]) and type(request.get("width")) in (int, float) and request["width"] > 0.0):
        raise BadInput("a stencil has a place and a width", field="place", limit="x, y and a width above 0 [m]")
    image, (x, y), width = _read(request.get("image")), request["place"], float(request["width"])
    mask = laid_out(image, bool(request.get("invert")), (float(x), float(y)), width, shape, cell)
    if not mask.any():
        raise BadInput("the stencil lies beside the cloth, or keeps nothing out", field="place", value=[x, y],
                       remedy="put it on the cloth; white keeps dye out, black with invert")  # fmt: skip
    try:
        path = reserve(scene.parent, f"{scene.stem}-stencil.png")
        Image.fromarray(mask, "L").save(path)
    except OSError as error:
        raise BadInput(f"the stencil's picture cannot be written: {error.strerror}", str(scene.parent)) from None
    return f"resist: {{kind: image, file: {flow(path.name)}}}", path


def _read(data: object) -> Image.Image:
    """Decode a PNG in base64 to grey and opacity. Raises BadInput."""
    try:
        image = Image.open(io.BytesIO(base64.b64decode(str(data), validate=True)), formats=["PNG"])
        if max(image.size) > MOST_IMAGE:
            raise BadInput("the stencil is too large", field="image", value=image.size, limit=f"{MOST_IMAGE} pixels")
        return cast(Image.Image, upright(image).convert("LA"))
    except UNREADABLE as error:
        raise BadInput(f"this stencil cannot be read: {error}", field="image", remedy="a PNG") from None


def laid_out(
    image: Image.Image, invert: bool, place: tuple[float, float], width: float, shape: Sequence[int], cell: float
) -> NDArray[np.uint8]:
    """Return the share of each cell that an image of grey and opacity covers, shape (ny, nx), 255 for all of it.

    The image is `width` [m] wide, with its centre at `place` [m] from the cloth's upper left corner.
    """
    ny, nx = shape
    fine = max(1, min(FINENESS, math.isqrt(MOST_PIXELS // (ny * nx))))
    pixel = cell / fine
    grey, opacity = (np.asarray(band, np.float32) / 255.0 for band in image.split())
    kept_out = Image.fromarray((1.0 - grey if invert else grey) * opacity)
    wide, high = (max(1, round(side * width / image.width / pixel)) for side in image.size)
    if wide * high > MOST_PIXELS:
        raise BadInput("the stencil is too large", field="width", value=width, limit="about the cloth's size")
    drawn = kept_out.resize((wide, high), Image.Resampling.BOX if wide < image.width else Image.Resampling.BILINEAR)
    cloth = Image.new("F", (nx * fine, ny * fine))
    cloth.paste(drawn, (round(place[0] / pixel - wide / 2), round(place[1] / pixel - high / 2)))
    share = np.asarray(cloth).reshape(ny, fine, nx, fine).mean(axis=(1, 3))
    return np.asarray(np.rint(255.0 * share).astype(np.uint8))


# The dyed cloth of scenes at the start, laid flat for painting in the page.

SIDE, MOST_SCALE = 1000, 8
"""Approximate pixels of a picture's longer side, and the most pixels per cell."""
MOST = 4
"""Pictures that are kept: each page shows the newest that it requested."""
PASTE = np.array([201.0, 150.0, 62.0])
"""sRGB of paste that takes all of a cell's capacity."""
SHOWN = 0.8
"""Opacity of paste."""


class Dyed:
    """Draws pictures of scenes' cloth when a page asks for them, without a run."""

    def __init__(self, workshop: Workshop) -> None:
        self._numbers = itertools.count(1)
        self._kept: dict[int, bytes] = {}
        self._workshop = workshop

    def see(self, page: str, *text: Any) -> dict[str, Any]:
        """Draw a scene's cloth, and return the picture's number, the size of a cell [m], the number of cells, and the
        dyes. `text` are the arguments of `scenes.load`. Raises BadInput.
        """
        picture, facts = self._workshop.make(page, _draw, *text)
        number = next(self._numbers)
        self._kept[number] = picture
        for old in sorted(self._kept)[:-MOST]:
            self._kept.pop(old, None)
        return {"number": number} | facts

    def tell(self, query: Mapping[str, list[str]]) -> tuple[str, bytes]:
        """Return a picture by its number. Raises Refused."""
        picture = self._kept.get(whole(query, "number"))
        if picture is None:
            raise Refused(NOT_FOUND, "this picture is no longer kept")
        return "image/png", picture


class Flat:
    """Draws cloths one after the other; the next is often the same with one more stroke."""

    def __init__(self) -> None:
        self._painter: _Painter | None = None

    def draw(self, loaded: Loaded) -> tuple[bytes, dict[str, Any]]:
        """Return the picture as PNG, and properties of the cloth for the page. Raises BadInput."""
        cells, phi, fixed = at_start(loaded)
        _, ny, nx = cells.fibre.shape
        dyes = [{"name": one.name, "colour": one.colour.dark} for one in loaded.dyed.said.dyes]
        facts = {"cell": cells.size, "cells": [nx, ny], "dyes": dyes, "object": loaded.dyed.said.object}
        return as_png(self._draw(loaded, cells, phi, fixed)), facts

    def _draw(self, loaded: Loaded, cells: Cells, phi: Float, fixed: Float) -> Picture:
        """Draw all of the cloth, with paste over it."""
        _, ny, nx = cells.fibre.shape
        scale = min(MOST_SCALE, max(1, round(SIDE / max(ny, nx))))
        colours = tuple(one.colour for one in loaded.dyed.said.dyes)
        plugin, config = loaded.dyed.picture.plugin, loaded.dyed.picture.config
        painter, settings = self._painter, (plugin.name, config, colours)
        if painter is None or not painter.draws(settings, cells):
            prepared = plugin.prepare(config, loaded.files, cells, colours, Window(0, ny, 0, nx), scale)
            painter = self._painter = _Painter(settings, cells, prepared)
        cloth: Picture = plugin.draw(painter.prepared, amount_seen(phi, fixed))
        opacity = SHOWN * cells.resist.mean(axis=0).repeat(scale, 0).repeat(scale, 1)[:, :, None]
        return np.asarray(np.rint((1.0 - opacity) * cloth + opacity * PASTE).astype(np.uint8))


_FLAT = Flat()
"""The one of a workshop's process."""


def _draw(*text: Any) -> tuple[bytes, dict[str, Any]]:
    return _FLAT.draw(scenes.load(*text))


def cloth_of(loaded: Loaded) -> tuple[Cells, DyeState, tuple[Supply, ...]]:
    """Build the cells, their amounts, and the supplies of dye. Raises BadInput for a scene without dye."""
    if loaded.scene.dye is None:
        raise BadInput(
            "only cloth to dye is painted", field="dye", remedy="begin from dye/drops, or add dye to the scene"
        )
    return build_cloth(loaded)


def at_start(loaded: Loaded) -> tuple[Cells, Float, Float]:
    """Return cells, and mobile and fixed amounts (dyes, 2, ny, nx) at the start of a run. Raises BadInput."""
    cells, state, supplies = cloth_of(loaded)
    dt = loaded.dyed.said.speed / loaded.scene.frame_rate  # a frame: later supplies have not begun
    Supplies(supplies, cells.mobile_room, dt, len(state.phi)).begin(state.phi, 0)
    return cells, state.phi, state.fixed


class _Painter(NamedTuple):
    """Prepared data of a cloth's pictures, which take most of their time and do not depend on strokes."""

    settings: tuple[Any, ...]
    cells: Cells
    prepared: Any

    def draws(self, settings: tuple[Any, ...], cells: Cells) -> bool:
        before, now = _visible(self.cells), _visible(cells)
        alike = len(before) == len(now) and all(map(np.array_equal, before, now))
        return self.settings == settings and self.cells.v_max == cells.v_max and alike


def _visible(cells: Cells) -> list[NDArray[Any]]:
    """Return the arrays that determine the look of a cloth without dye."""
    photograph = (cells.photograph.light, cells.photograph.warp) if cells.photograph is not None else ()
    return [cells.fibre, cells.up, *(cells.yarns or ()), *(cells.ground or ()), *photograph]
