"""Pictures of a recording's dyed cloth, with name, time and a scale below, and the texture of a dyed object."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np

from nuno.dye.painter import PICTURE_SIDE, DyePainter
from nuno.exports.cloth import ShownPiece, find_message
from nuno.formatting import time_of
from nuno.output_files import Progress, following
from nuno.recording.reader import Recording
from nuno.recording.recorded import Recorded
from nuno.scene.recorded_scene import restored_scene
from nuno_schemas.dyeing import Crop, DyeView
from nuno_schemas.errors import BadInput
from nuno_schemas.messages import CLOTH, CONCENTRATION
from nuno_schemas.pictures import Picture

CHANGEABLE = re.compile(r"dye\.(picture|dyes[.[][\w-]+\]?\.colour)\b")
"""Fields of a recorded scene that change only its pictures."""
TEXTURE_SIDE = 1536
"""Approximate longer side of a texture with `scale: auto` [pixels]."""
INK, PAPER = (58, 58, 62), (250, 249, 246)
FONT, BAND = 15, 30
"""Heights of text and of the strip below a picture [pixels]."""
UNITS = ((1e-6, "um"), (1e-3, "mm"), (1.0, "m"))


@dataclass(frozen=True)
class Changes:
    """Changes of a scene's pictures: None keeps the scene's value; `overrides` are key=value."""

    view: DyeView | None = None
    scale: int | None = None
    crop: Crop | None = None
    overrides: tuple[str, ...] = ()


class DyedPictures:
    """Draws the dyed cloth of a recording: by itself, or as the texture of an object `name`.

    Raises BadInput for a recording that is damaged, or cannot be drawn.
    """

    def __init__(self, recording: Recording, painter: DyePainter, name: str = "") -> None:
        self.recording, self.painter, self.name = recording, painter, name
        self._last: tuple[int, Picture] | None = None
        cloth = recording.last(CLOTH.name)
        if cloth is None:
            raise BadInput("the recording does not describe the cloth that is dyed", str(recording.path))
        with recording.damage_reported(cloth):
            painter.take_cloth(cloth.payload)

    def picture(self, message: Recorded) -> Picture:
        """Return a picture (h, w, 3) sRGB of one frame's amounts."""
        with self.recording.damage_reported(message):
            return self.painter.draw(message.payload)

    def draw(self, message: Recorded) -> Picture:
        """Return a picture (h, w, 3) sRGB of one frame's amounts, with a caption below if there is room for it."""
        picture, painter = self.picture(message), self.painter
        scene, view = self.recording.scene.get("name", ""), painter.look.view
        shown = "" if view == "all" else f"{view} dye   "
        return caption(picture, f"{scene}   {shown}t = {_time(painter.time)}", painter.pixel)

    def dress(self, pieces: list[ShownPiece], t: float) -> list[ShownPiece]:
        """Return the pieces of cloth, the dyed one with its texture at t [s]. Raises BadInput for damaged amounts.

        The cells cover the object's texture coordinates, with x to the right as u and y down as 1 - v: the picture is a
        texture like any other.
        """
        return [
            replace(piece, image=self.texture(t), colour=None)
            if piece.name == self.name and piece.laid_out is not None
            else piece
            for piece in pieces
        ]

    def texture(self, t: float) -> Picture | None:
        """Return the texture (h, w, 3) sRGB at the last recorded time until t [s]; None before the first."""
        message = self.recording.last(CONCENTRATION.name, t)
        if message is None:
            return None
        if self._last is None or self._last[0] != message.log_time:
            self._last = message.log_time, self.picture(message)
        return self._last[1]


@contextmanager
def changed_painter(recording: Recording, changes: Changes, side: int = PICTURE_SIDE) -> Iterator[DyePainter]:
    """Yield the painter of a recording's scene with changes, while the scene's files exist. Raises BadInput."""
    values = {"view": changes.view, "scale": changes.scale, "crop": changes.crop}
    for item in changes.overrides:
        if not CHANGEABLE.match(item):
            problem, limit = "this field is no matter of pictures", "dye.picture and a dye's colour"
            remedy = "for example --set dye.dyes.0.colour.full=0.1"
            raise BadInput(problem, "--set", value=item, limit=limit, remedy=remedy)
    with restored_scene(recording, changes.overrides) as loaded:
        painter = DyePainter(loaded, side)
        painter.look = painter.look.model_copy(update={name: v for name, v in values.items() if v is not None})
        yield painter


@contextmanager
def dyed_pictures(
    recording: Recording, changes: Changes | None = None, side: int = PICTURE_SIDE
) -> Iterator[DyedPictures]:
    """Yield the pictures of a recording by its scene with changes. Raises BadInput."""
    with changed_painter(recording, changes or Changes(), side) as painter:
        yield DyedPictures(recording, painter)


def read_dyed_object(recording: Recording, changes: Changes | None = None) -> DyedPictures | None:
    """Return the pictures of a recording's dyed object, or None. Raises BadInput."""
    dye = recording.scene.get("dye")
    name = dye.get("object") if isinstance(dye, dict) else None
    if name is None:
        return None
    with changed_painter(recording, changes or Changes(), TEXTURE_SIDE) as painter:
        return DyedPictures(recording, painter, str(name))


def find_amounts(recording: Recording, number: int | None) -> Recorded:
    """Return the amounts of a frame by its number, or the last. Raises BadInput if they are not in the recording."""
    message, times = find_message(recording, CONCENTRATION.name, number)
    if message is None and number in times:
        shown = [recording.marks()[at][0] for at in _recorded(recording)]
        limit = f"the nearest is frame {min(shown, key=lambda one: abs(one - number))}" if shown else "it holds none"
        problem, remedy = "the amounts of this frame are not in the recording", "name a frame that is"
        raise BadInput(problem, str(recording.path), field="--frame", value=number, limit=limit, remedy=remedy)
    if message is None:
        raise recording.no_frame(number, times)
    return message


def _recorded(recording: Recording) -> list[int]:
    """Return the log times [ns] of the frames with recorded amounts, which may be fewer than all."""
    if recording.counts.get(CONCENTRATION.name, 0) == len(recording.marks()):
        return sorted(recording.marks())
    return [message.log_time for message in recording.messages([CONCENTRATION.name])]


def choose_amounts(recording: Recording, start: float | None, end: float | None) -> list[float]:
    """Return the times of the recorded amounts from `start` to `end` [s]. Raises BadInput if there are none."""
    times = [time / 1e9 for time in _recorded(recording)]
    first, last = (-np.inf if start is None else start), (np.inf if end is None else end)
    chosen = [time for time in times if first <= time <= last]
    if not chosen:
        limit = f"{times[0]:g} to {times[-1]:g} s" if times else "it holds no frames"
        problem = "nothing to show between start and end"
        raise BadInput(problem, str(recording.path), value=(start, end), limit=limit)
    return chosen


def draw_amounts(pictures: DyedPictures, times: list[float], progress: Progress | None = None) -> Iterator[Picture]:
    """Draw the frames at chosen times [s], in order; a repeated time gives one picture."""
    wanted = {round(time * 1e9) for time in times}
    messages = pictures.recording.messages([CONCENTRATION.name], times[0], times[-1] + 1e-9)
    shown = (message for message in messages if message.log_time in wanted)
    return map(pictures.draw, following(shown, len(wanted), progress))


def caption(picture: Picture, text: str, pixel: float | None) -> Picture:
    """Add a strip with a text and a scale bar below a picture, each only if there is room for it.

    `pixel` is the side of a pixel [m], None without a scale. The font is Pillow's own, which is the same on every
    machine.
    """
    from PIL import Image, ImageDraw, ImageFont

    height, width = picture.shape[:2]
    image = Image.new("RGB", (width, height + BAND), PAPER)
    draw, font = ImageDraw.Draw(image), ImageFont.load_default(FONT)
    reach = draw.textlength(text, font)
    if reach + 2 * FONT > width:
        return picture
    image.paste(Image.fromarray(picture), (0, 0))
    middle = height + BAND // 2
    draw.text((FONT // 2, middle), text, INK, font, anchor="lm")
    if pixel is None:
        return np.asarray(image)
    length, label = _bar(pixel, width)
    if reach + length + draw.textlength(label, font) + 5 * FONT < width:
        right = width - FONT // 2
        draw.text((right, middle), label, INK, font, anchor="rm")
        right -= round(draw.textlength(label, font)) + FONT // 2
        draw.rectangle((right - length, middle - 2, right - 1, middle + 1), INK)
    return np.asarray(image)


def _bar(pixel: float, width: int) -> tuple[int, str]:
    """Return the length [pixels] and label of the longest bar of 1, 2 or 5 times a power of ten within a fifth of the
    width.
    """
    most = 0.2 * width * pixel
    power = 10.0 ** np.floor(np.log10(most))
    length = max(step * power for step in (1, 2, 5) if step * power <= most * (1.0 + 1e-9))
    unit, name = max((u for u in UNITS if u[0] <= length * (1.0 + 1e-9)), default=UNITS[0])
    return round(length / pixel), f"{length / unit:.3g} {name}"


def _time(t: float) -> str:
    unit, name = time_of(t)
    return f"{t / unit:.3g} {name}"
