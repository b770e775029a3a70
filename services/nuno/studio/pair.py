"""Two recordings on one clock, and how far their cloth is apart."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np

from nuno.studio.film import Film, Still
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float

AT_ONCE = 16
"""Frames of both that are read together."""


class Pair:
    """Two films, compared over the time that both have.

    The clock is the frames of the one that has fewer there. The other one's positions are those of its frame at that
    very time, and where it has none at it, interpolated linearly between its nearest two.

    times   log times [ns] of the clock
    exact   at which of them both have a frame
    origin  (3,) [m] about which positions of both are shown

    Raises BadInput for films that cannot be compared.
    """

    def __init__(self, first: Film, second: Film) -> None:
        self.films = first, second
        for film in self.films:
            if not film.moves or not film.times:
                remedy = "choose runs whose cloth moves"
                raise BadInput("there are no positions in it to compare", str(film.recording.path), remedy=remedy)
        start, end = (pick(film.times[i] for film in self.films) for pick, i in ((max, 0), (min, -1)))
        if start > end:
            spans = ", ".join(f"{film.times[0] / 1e9:g} to {film.times[-1] / 1e9:g} s" for film in self.films)
            raise BadInput("the recordings have no time in common", limit=spans)
        shared = [[time for time in film.times if start <= time <= end] for film in self.films]
        self.times: list[int] = min(filter(None, shared), key=len, default=[])
        if not self.times:
            limit = f"{start / 1e9:g} to {end / 1e9:g} s"
            raise BadInput("neither recording has a frame in the time that both have", limit=limit)
        self.origin: Float = min((film.origin for film in self.films), key=tuple)  # of both the same, whoever is first
        known = [set(times) for times in shared]
        self.exact = [all(time in times for times in known) for time in self.times]
        self._far: list[tuple[float | None, float | None]] = []
        self._problem = ""
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._measure, name="compare", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Measure no further."""
        self._closed.set()
        self._thread.join()

    def tell(self) -> dict[str, Any]:
        """What has been measured so far, from the first frame of the clock on: the largest distance and the root of the
        mean square of all vertices' [m], None where the meshes are not the same; whether that is all.
        """
        far = list(self._far)
        done = len(far) == len(self.times) or bool(self._problem)
        return {
            "largest": [one[0] for one in far],
            "rms": [one[1] for one in far],
            "measured": done,
            "problem": self._problem,
        }

    def _measure(self) -> None:
        try:
            for first in range(0, len(self.times), AT_ONCE):
                times = self.times[first : first + AT_ONCE]
                sides = [film.stills(times) for film in self.films]
                for one, two in zip(*sides, strict=True):
                    self._far.append(measure(self.distances(one, two)))
                if self._closed.is_set():
                    return
        except Exception as error:  # whatever it is, the page waits for an end
            self._problem = str(error) or type(error).__name__
            if not isinstance(error, BadInput):
                raise

    def distances(self, one: Still, two: Still) -> Float | None:
        """(n,) [m] between a vertex of the first film's cloth and the same vertex of the second's; None where their
        meshes are not the same.
        """
        shapes = (film.shape(still.shape) for film, still in zip(self.films, (one, two), strict=True))
        if one.x.shape != two.x.shape or not next(shapes).same_as(next(shapes)):
            return None
        return np.asarray(np.linalg.norm(one.x - two.x, axis=1))


def measure(distances: Float | None) -> tuple[float | None, float | None]:
    """The largest of distances (n,) and the root of their mean square; None for none, and where one is not finite."""
    if distances is None or not len(distances) or not np.isfinite(distances).all():
        return None, None
    return float(distances.max()), float(np.sqrt((distances**2).mean()))
