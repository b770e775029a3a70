"""From a cloth's arrays to the bands that the kernel steps, and back."""

from __future__ import annotations

import itertools

import numpy as np

from nuno_dye.diffusion import GHOST, LEFT, Bands
from nuno_dye.faces import Faces
from nuno_kernels.simd import WIDTH
from nuno_schemas.fabric import Float


def make_bands(phi: Float, faces: Faces, scale: float, number: int) -> Bands:
    """Bands of about equal height of amounts (2, ny, nx); weights are `scale` times the face values.

    There are at most `number`, and fewer where a band would be lower than the rows that its neighbours copy.
    """
    _, ny, nx = phi.shape
    number = max(1, min(number, ny // GHOST))
    cuts = np.linspace(0, ny, number + 1).astype(np.int64)
    top = 1 + GHOST
    r, w = int(np.diff(cuts).max()) + 2 * top, LEFT + -(-nx // WIDTH) * WIDTH + WIDTH
    bands = Bands(
        *np.zeros((3, number, 2 * r, w)),
        np.zeros((number, r, w)),
        np.zeros((number, 2 * GHOST, w)),
        np.full(number, top),
        top + np.diff(cuts) - 1,
        np.ones((number, 2), np.int64),
    )
    bands.shrinks[0, 0] = bands.shrinks[-1, 1] = 0
    for b, (low, high) in enumerate(itertools.pairwise(cuts)):
        start, stop = max(0, low - GHOST), min(ny, high + GHOST)
        rows = slice(top - (low - start), top - (low - start) + stop - start)
        for layer in range(2):
            place = (b, slice(rows.start + layer * r, rows.stop + layer * r), slice(LEFT, LEFT + nx))
            bands.phi[place] = phi[layer, start:stop]
            bands.along[place] = scale * faces.along[layer, start:stop]
            bands.down[place] = scale * faces.down[layer, start:stop]
        bands.across[b, rows, LEFT : LEFT + nx] = scale * faces.across[start:stop]
    return bands


def read_bands(bands: Bands, out: Float) -> Float:
    """Put the amounts of all bands into (2, ny, nx)."""
    r, nx, at = bands.across.shape[1], out.shape[2], 0
    for b in range(bands.phi.shape[0]):
        rows = int(bands.last[b] - bands.first[b]) + 1
        for layer in range(2):
            start = int(bands.first[b]) + layer * r
            out[layer, at : at + rows] = bands.phi[b, start : start + rows, LEFT : LEFT + nx]
        at += rows
    return out
