"""How high and how wide drawn wrinkles stand over the chords across them, wherever the cloth has gone since.

Over the cloth as it lay before they would not do: a line adds cloth, so that the feet of its wrinkle move as well, and
what has sunk with its feet would count as faded.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nuno.draw.lines import distance_to
from nuno_schemas.fabric import Bool, Float, Int

NEAR = 0.06
"""What lies so near to a line when it is drawn belongs to its wrinkle [m]."""


class Ridge(NamedTuple):
    """Means over a line's crests [m]: height over the chord across it, as a run's report has it, and width at half of
    that, along the chord. NaN where the line has no crest.
    """

    height: float
    width: float


class Drawn:
    """Crests of lines, and the triangles of each line's wrinkle.

    x (n, 3) [m] just drawn and its faces (f, 3); crests (5, c) vertices: on a line, to the left and to the right of it
    where nothing was smoothed, before and after on the line; lines (k, 3) [m] near x, each crest of the nearest.
    """

    def __init__(self, x: Float, faces: Int, crests: Int, lines: list[Float]) -> None:
        away = np.stack([distance_to(x, line) for line in lines], axis=1)
        nearest = away[crests[0]].argmin(axis=1)
        self._crests = [crests[:, nearest == i] for i in range(len(lines))]
        self._faces = [faces[(away[:, i] < NEAR)[faces].all(axis=1)] for i in range(len(lines))]

    def measure(self, x: Float) -> list[Ridge]:
        """Of every line, with the cloth at x (n, 3) [m]."""
        found = []
        for crests, faces in zip(self._crests, self._faces, strict=True):
            each = np.array([_across(x, faces, crest) for crest in crests.T]).reshape(-1, 2)
            found.append(Ridge(*each.mean(axis=0).tolist()) if len(each) else Ridge(float("nan"), float("nan")))
        return found


def _across(x: Float, faces: Int, crest: Int) -> tuple[float, float]:
    """Height of a crest over its chord, and how wide it is at half of that [m].

    The plane through chord and normal cuts the triangles in segments. What lies between the outermost points that reach
    half the height is the width, so that a wrinkle that has folded over is not counted twice.
    """
    top, one, other, before, after = x[crest]
    chord = (other - one) / np.linalg.norm(other - one)
    normal = np.cross(chord, after - before)
    normal /= np.linalg.norm(normal)
    normal *= np.sign((top - one) @ normal)
    height = float((top - one) @ normal)
    u, w, beside = (x - one) @ chord, (x - one) @ normal, (x - top) @ np.cross(chord, normal)
    start, end = _cut(faces, beside >= 0.0, np.stack([u, w], axis=1), beside)
    low, high = np.minimum(start[:, 1], end[:, 1]), np.maximum(start[:, 1], end[:, 1])
    half = 0.5 * height
    share = np.clip((half - start[:, 1]) / np.where(high > low, end[:, 1] - start[:, 1], 1.0), 0.0, 1.0)
    level = start[:, 0] + share * (end[:, 0] - start[:, 0])
    places = np.concatenate([start[start[:, 1] >= half, 0], end[end[:, 1] >= half, 0],
                             level[(low < half) & (high >= half)]])  # fmt: skip
    within = places[(places >= 0.0) & (places <= np.linalg.norm(other - one))]
    return height, float(np.ptp(within)) if len(within) else 0.0


def _cut(faces: Int, left: Bool, flat: Float, beside: Float) -> tuple[Float, Float]:
    """Ends (s, 2) of the segments in which the plane cuts triangles: `flat` (n, 2) where `beside` (n,) is 0."""
    cut = faces[left[faces].any(axis=1) & ~left[faces].all(axis=1)]
    # The corner that is alone on its side, then the other two.
    alone = np.argmax(left[cut] == (left[cut].sum(axis=1) == 1)[:, None], axis=1)
    rows = np.arange(len(cut))
    first, second, third = (cut[rows, (alone + k) % 3] for k in range(3))
    ends = []
    for far in (second, third):
        share = (beside[first] / (beside[first] - beside[far]))[:, None]
        ends.append(flat[first] + share * (flat[far] - flat[first]))
    return ends[0], ends[1]
