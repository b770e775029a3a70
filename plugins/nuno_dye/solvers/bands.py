"""Conversion of a cloth's arrays to the bands that kernels step, and back."""

from __future__ import annotations

import itertools
import math

import numpy as np

from nuno_dye.laws.diffusivity import Faces, largest_sum
from nuno_dye.solvers.diffusion import GHOST, LEFT, Bands, Rows
from nuno_dye.solvers.dyeing import EMPTYING, LEVELS, SCRATCH_ROWS, DyeBands
from nuno_kernels.lanes import WIDTH
from nuno_schemas.dye import Cells
from nuno_schemas.fabric import Float


def make_bands(phi: Float, faces: Faces, scale: float, number: int) -> Bands:
    """Return bands for diffusion alone, of amounts (2, ny, nx); weights are `scale` times the face values."""
    cut = Cut(phi.shape, number, GHOST)
    edge = zeros(cut.number, 2 * GHOST, cut.width)
    (amounts,), (along, down, across) = cut.fill(phi), cut.fill_faces(faces, scale)
    return Bands(amounts, along, down, across, edge, *cut.places())


def make_dye_bands(
    phi: Float, cells: Cells, faces: Faces, scale: float, number: int, steepest: float = 1.0
) -> DyeBands:
    """Return bands for the whole step, of mobile amounts (2, ny, nx); `steepest` is the largest D over D0 P T."""
    cut = Cut(phi.shape, number, 2 * LEVELS)
    rolling = zeros(cut.number, SCRATCH_ROWS * LEVELS, cut.width)
    mobile, most = cut.fill(phi, cells.mobile_room)
    along, down, across = cut.fill_faces(faces, scale)
    # A cell's outflow is at most its amount times the sum of D over its faces.
    empties = scale * steepest * largest_sum(faces) > EMPTYING
    return DyeBands(mobile, along, down, across, most, rolling, *cut.places(), empties)


def zeros(*shape: int) -> Float:
    """Return zeros that begin at a multiple of a vector's size, as all rows then do: no vector crosses a line of the
    cache.
    """
    room = np.zeros(math.prod(shape) + WIDTH)
    begin = -room.ctypes.data // room.itemsize % WIDTH
    return room[begin : begin + math.prod(shape)].reshape(shape)


class Cut:
    """A division of rows into bands of about equal height, with `ghost` rows of their neighbours on either side. There
    are at most `number` bands, and fewer if a band would be lower than the rows that its neighbours copy.
    """

    def __init__(self, shape: tuple[int, ...], number: int, ghost: int) -> None:
        _, self.ny, self.nx = shape
        self.number, self.ghost, self.top = max(1, min(number, self.ny // ghost)), ghost, 2 + ghost
        self.cuts = np.linspace(0, self.ny, self.number + 1).astype(np.int64)
        self.height = int(np.diff(self.cuts).max()) + 2 * self.top
        self.width = LEFT + -(-self.nx // WIDTH) * WIDTH + WIDTH

    @property
    def shape(self) -> tuple[int, int, int]:
        """Shape of the amounts of both layers in bands."""
        return self.number, 2 * self.height, self.width

    def fill(self, *arrays: Float) -> list[Float]:
        """Return each of the arrays (layers, ny, nx) as (bands, layers * height, width)."""
        return [self._fill(array) for array in arrays]

    def fill_faces(self, faces: Faces, scale: float) -> list[Float]:
        return self.fill(scale * faces.along, scale * faces.down, scale * faces.across[None])

    def _fill(self, array: Float) -> Float:
        layers = array.shape[0]
        out = zeros(self.number, layers * self.height, self.width)
        for b, (low, high) in enumerate(itertools.pairwise(self.cuts)):
            start, stop = max(0, low - self.ghost), min(self.ny, high + self.ghost)
            first = self.top - (low - start)
            for layer in range(layers):
                at = first + layer * self.height
                out[b, at : at + stop - start, LEFT : LEFT + self.nx] = array[layer, start:stop]
        return out

    def places(self) -> tuple[Rows, Rows, Rows]:
        """Return the bands' own rows: the fields first, last and shrinks of nuno_dye.solvers.diffusion.Bands."""
        shrinks = np.ones((self.number, 2), np.int64)
        shrinks[0, 0] = shrinks[-1, 1] = 0
        return np.full(self.number, self.top), self.top + np.diff(self.cuts) - 1, shrinks


def read_bands(bands: Bands | DyeBands, values: Float, out: Float) -> Float:
    """Write amounts of the bands into `out` (2, ny, nx)."""
    r, nx, at = bands.across.shape[1], out.shape[2], 0
    for b in range(values.shape[0]):
        rows = int(bands.last[b] - bands.first[b]) + 1
        for layer in range(2):
            start = int(bands.first[b]) + layer * r
            out[layer, at : at + rows] = values[b, start : start + rows, LEFT : LEFT + nx]
        at += rows
    return out
