"""Dye, paste and stencils that are put on cloth by the mouse: items of the scene, and the cells that it has by them.

A stroke becomes what scenes say strokes by: a supply `stroke`, or a resist `paste`, a line of points and a width. A
mask of pixels would say the same less exactly and unreadably, and a run that goes on takes these, but no new image.
A stencil becomes a picture of a grey value for each cell, beside the scene, and the resist `image` that names it.
"""

from __future__ import annotations

import base64
import binascii
import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from nuno.dye.add import parse
from nuno.scene import edit, yaml_lines
from nuno.scene.edit import flow
from nuno.studio.arrivals import reserve
from nuno_schemas.colour import upright
from nuno_schemas.dye import Cells
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float

UNREADABLE = (binascii.Error, UnidentifiedImageError, Image.DecompressionBombError, OSError, ValueError, SyntaxError)
"""What is raised for data that are no picture, or one too large to be taken apart."""
OFF = 0.25
"""Of a cell: how far a line that is written may be off the one that was drawn."""
FINENESS, MOST_PIXELS = 4, 2**25
"""Pixels a cell, each way, that a stencil is laid out on, and how many of them at most."""
MOST_IMAGE = 4000
"""Pixels of a stencil's side."""


def live_item_of(said: Mapping[str, Any], cells: Cells) -> str:
    """The item that a stroke of the page is for a run that goes on. Raises BadInput."""
    if said.get("tool") == "stencil":
        problem, remedy = "a run takes no new image, which its recording would lack", "stop it, and put it in the text"
        raise BadInput(problem, field="tool", remedy=remedy)
    return stroke_of(said, cells.size)


def item_of(said: Mapping[str, Any], cells: Cells, scene: Path, own: bool) -> tuple[str, Path | None]:
    """The item that a stroke or a stencil of the page is, as `nuno control add` takes it, and the picture that was
    written for it. Raises BadInput.

    own  whether the scene lies in the page's folder, into which pictures are written
    """
    if said.get("tool") != "stencil":
        return stroke_of(said, cells.size), None
    if not own:
        remedy = "save the scene under a name of yours first"
        raise BadInput("a stencil's picture is written beside the scene, which comes with nuno", remedy=remedy)
    return stencil_of(said, cells.fibre.shape[1:], cells.size, scene)


def stroke_of(said: Mapping[str, Any], cell: float) -> str:
    """The item that a stroke of the page is, as `nuno control add` takes it. Raises BadInput.

    said  `tool` dye or paste, `points` [m] and `width` [m]; of dye `dye`, its name, and `amount`
    cell  side of a cell [m]
    """
    points = np.array(said.get("points"), np.float64) if _numbers(said.get("points")) else np.zeros((0, 2))
    width = said.get("width")
    if not (points.ndim == 2 and points.shape[1:] == (2,) and len(points) and np.isfinite(points).all()):
        raise BadInput("a stroke has points", field="points", limit="pairs of x and y [m]")
    if not (isinstance(width, int | float) and 0.0 < width < math.inf):
        raise BadInput("a brush has a width", field="width", value=width, limit="above 0 [m]")
    line = ", ".join(f"[{_length(x, cell)}, {_length(y, cell)}]" for x, y in simplified(points, OFF * cell).tolist())
    rest = f"points: [{line}], width: {_length(float(width), cell)}"
    if said.get("tool") == "paste":
        return f"resist: {{kind: paste, {rest}}}"
    amount = said.get("amount")
    if type(amount) not in (int, float):
        raise BadInput("a brush has an amount of dye", field="amount", value=amount, limit="0 to 1")
    return f"supply: {{kind: stroke, dye: {flow(str(said.get('dye')))}, {rest}, amount: {amount:.3g}}}"


def _numbers(points: object) -> bool:
    """Whether these are pairs of numbers, before NumPy takes them for anything."""
    return isinstance(points, list) and all(
        isinstance(one, list) and len(one) == 2 and all(type(value) in (int, float) for value in one) for one in points
    )


def _length(metres: float, cell: float) -> str:
    """A length in mm, to a hundredth of a cell."""
    digits = max(0, 2 - math.floor(math.log10(cell * 1e3)))
    text = f"{round(metres * 1e3, digits) + 0.0:.{digits}f}"
    return f"{text.rstrip('0').rstrip('.') if digits else text} mm"


def simplified(points: Float, off: float) -> Float:
    """(m, 2) the fewest of a line's points (n, 2), ends kept, that no other is further than `off` from (Douglas and
    Peucker 1973).
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
    found: Float = points[keep]
    return found


def put(text: str, item: str, file: str) -> str:
    """The scene's text with one supply or resist more. Raises BadInput."""
    place, fields = parse(item)
    data, _ = yaml_lines.parse(text, file)
    there = data.get("dye", {}).get("cloth", {}).get(place) or []
    written = item.split(":", 1)[1].strip()
    return edit.put(text, ("dye", "cloth", place, len(there)), fields, file, written)


def stencil_of(said: Mapping[str, Any], shape: Sequence[int], cell: float, scene: Path) -> tuple[str, Path]:
    """The item that a stencil of the page is, and its picture, which is written beside the scene. Raises BadInput.

    said   `image`, a PNG in base64 of which white keeps dye out, black where it is to be `invert`ed; its middle `place`
           [m] and its `width` [m]
    shape  (ny, nx) of the cloth
    """
    if not (_numbers([said.get("place")]) and type(said.get("width")) in (int, float) and said["width"] > 0.0):
        raise BadInput("a stencil has a place and a width", field="place", limit="x, y and a width above 0 [m]")
    image, (x, y), width = _read(said.get("image")), said["place"], float(said["width"])
    mask = laid_out(image, bool(said.get("invert")), (float(x), float(y)), width, shape, cell)
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
    """A PNG in base64 as grey and opacity. Raises BadInput."""
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
    """(ny, nx) how much of each cell an image of grey and opacity covers, 255 for all of it.

    The image is `width` [m] wide, with its middle at `place` [m] from the cloth's upper left corner.
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
    mask: NDArray[np.uint8] = np.rint(255.0 * share).astype(np.uint8)
    return mask
