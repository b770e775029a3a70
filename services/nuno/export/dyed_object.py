"""An object that is dyed: its texture at any time of a recording."""

from __future__ import annotations

from dataclasses import replace

from nuno.dye.painter import DyePainter
from nuno.export.cloth import Piece
from nuno.export.dyed_pictures import Changes, changed_painter
from nuno.recording.reader import Recording
from nuno.wire.arrays import BadMessage
from nuno_schemas.dye_picture import Picture
from nuno_schemas.errors import BadInput
from nuno_schemas.messages import CLOTH, CONCENTRATION

TEXTURE_SIDE = 1536
"""Pixels of a texture's longer side that `scale: auto` aims at."""


class DyedObject:
    """Gives the object that a scene dyes the picture of its cloth as its texture.

    The cloth's cells cover the object's texture coordinates, x to the right being u and y down 1 - v: the picture
    is an image as any other that is laid on cloth.
    """

    def __init__(self, recording: Recording, name: str, painter: DyePainter) -> None:
        self.recording, self.name, self.painter = recording, name, painter
        self._last: tuple[int, Picture] | None = None
        cloth = recording.last(CLOTH.name)
        if cloth is None:
            raise BadInput("the recording does not describe the cloth that is dyed", str(recording.path))
        try:
            painter.take_cloth(cloth.payload)
        except BadMessage as error:
            raise self._damaged(error) from None

    def dress(self, pieces: list[Piece], t: float) -> list[Piece]:
        """The pieces of cloth, the dyed one with its texture at t [s]. Raises BadInput where amounts are damaged."""
        return [
            replace(piece, image=self.texture(t), colour=None)
            if piece.name == self.name and piece.uv is not None
            else piece
            for piece in pieces
        ]

    def texture(self, t: float) -> Picture | None:
        """(h, w, 3) sRGB at t [s], or at the last time before it that was recorded; None before the first."""
        message = self.recording.last(CONCENTRATION.name, t)
        if message is None:
            return None
        if self._last is None or self._last[0] != message.log_time:
            try:
                self._last = message.log_time, self.painter.draw(message.payload)
            except BadMessage as error:
                raise self._damaged(error) from None
        return self._last[1]

    def _damaged(self, error: BadMessage) -> BadInput:
        return BadInput(f"the recording is damaged: {error}", str(self.recording.path))


def read_dyed_object(recording: Recording, changes: Changes | None = None) -> DyedObject | None:
    """What is dyed of a recording's objects, None where nothing is. Raises BadInput."""
    dye = recording.scene.get("dye")
    name = dye.get("object") if isinstance(dye, dict) else None
    if name is None:
        return None
    with changed_painter(recording, changes or Changes(), TEXTURE_SIDE) as painter:
        return DyedObject(recording, str(name), painter)
