"""What the cloth of a recording consists of, as the page shows it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from nuno.exports.cloth import ShownPiece, cut_pieces, read_texture
from nuno.exports.paint import PLAIN
from nuno.exports.shapes import sample
from nuno.recording.reader import Recording
from nuno.seen.sight import NO_EDGES, NO_FACES, NO_LENGTHS
from nuno_schemas.colour import parse_hex, to_srgb
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Int


@dataclass(frozen=True)
class Shape:
    """What the cloth consists of until an operation changes it.

    faces (f, 3), edges (e, 2) with rest (e,) [m]: threads and links; colours (n, 3) float32 sRGB in [0, 1] where an
    image lies on it, else None.
    """

    pieces: tuple[ShownPiece, ...]
    faces: Int
    edges: Int
    rest: NDArray[np.float32]
    colours: NDArray[np.float32] | None

    def same_as(self, other: Shape) -> bool:
        """Whether each vertex is the same of the same cloth in both."""
        return all(
            (one.start, one.stop) == (two.start, two.stop)
            and np.array_equal(one.faces, two.faces)
            and np.array_equal(one.edges, two.edges)
            for one, two in zip(self.pieces, other.pieces, strict=False)
        ) and len(self.pieces) == len(other.pieces)


def read_shape(recording: Recording, t: float) -> Shape:
    """The cloth's at t [s]. Raises BadInput where its description is damaged."""
    try:
        cut = cut_pieces(*recording.fabric(t))
    except (LookupError, ValueError, TypeError, AttributeError, OverflowError) as error:
        raise BadInput(f"the recording does not describe its cloth: {error}", str(recording.path)) from None
    pieces = [p if p.laid_out is None else replace(p, image=read_texture(recording, p.texture)) for p in cut]
    faces, edges, rest = (
        np.concatenate([none, *rows])
        for none, rows in (
            (NO_FACES, (piece.faces + piece.start for piece in pieces)),
            (NO_EDGES, (piece.edges + piece.start for piece in pieces)),
            (NO_LENGTHS, (piece.rest for piece in pieces)),
        )
    )
    return Shape(tuple(pieces), faces, edges, rest.astype(np.float32), _printed(pieces))


def _printed(pieces: Sequence[ShownPiece]) -> NDArray[np.float32] | None:
    """(n, 3) sRGB of all vertices where an image lies on a piece, else None: each has the colour of its pixel."""
    if all(piece.image is None for piece in pieces):
        return None
    colours = np.ones((max(piece.stop for piece in pieces), 3), np.float32)
    for piece in pieces:
        own = colours[piece.start : piece.stop]
        own[:] = to_srgb(parse_hex(piece.colour or PLAIN))
        if piece.image is not None and (laid := piece.laid_out) is not None:
            own[laid.vertex] = sample(piece.image, laid.points) / 255.0
    return colours
