"""Replay of recordings in the page: requests for one, comparison of two, and their frames as bytes."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno.scene.edit import flow
from nuno.scene.files import stamp_of
from nuno.studio.film import Film, Still
from nuno.studio.live_view import SAID, about, pack
from nuno.studio.recordings import Recordings
from nuno.studio.server import BAD_REQUEST, NOT_FOUND, Refused, whole
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float
from nuno_schemas.written import Path as Place
from nuno_schemas.written import dotted

# Two recordings on one clock, and the distance between their cloths.

AT_ONCE = 16
"""Frames of both that are read together."""


class Pair:
    """Two films, compared over their common time.

    The clock is the frames of the film with fewer frames in that time. The other film's positions are those of its
    frame at the same time, or interpolated linearly between its nearest two.

    times   log times [ns] of the clock
    exact   whether both have a frame at each of them
    origin  (3,) [m] common origin of the shown positions

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
        self.origin: Float = min((film.origin for film in self.films), key=tuple)  # independent of their order
        sets = [set(times) for times in shared]
        self.exact = [all(time in times for times in sets) for time in self.times]
        self._measures: list[tuple[float | None, float | None]] = []
        self._problem = ""
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._measure, name="compare", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop measuring."""
        self._closed.set()
        self._thread.join()

    def tell(self) -> dict[str, Any]:
        """Return the measurements so far, from the first frame of the clock on: the largest distance and the root mean
        square over all vertices [m], None for different meshes; and whether they are complete.
        """
        measures = list(self._measures)
        done = len(measures) == len(self.times) or bool(self._problem)
        return {
            "largest": [one[0] for one in measures],
            "rms": [one[1] for one in measures],
            "measured": done,
            "problem": self._problem,
        }

    def _measure(self) -> None:
        try:
            for first in range(0, len(self.times), AT_ONCE):
                times = self.times[first : first + AT_ONCE]
                sides = [film.stills(times) for film in self.films]
                for one, two in zip(*sides, strict=True):
                    self._measures.append(measure(self.distances(one, two)))
                if self._closed.is_set():
                    return
        except Exception as error:  # the page waits for an end, whatever the error
            self._problem = str(error) or type(error).__name__
            if not isinstance(error, BadInput):
                raise

    def distances(self, one: Still, two: Still) -> Float | None:
        """Return the distance of each vertex of the first film's cloth from the same vertex of the second's, shape (n,)
        [m]; None for different meshes.
        """
        shapes = (film.shape(still.shape) for film, still in zip(self.films, (one, two), strict=True))
        if one.x.shape != two.x.shape or not next(shapes).same_as(next(shapes)):
            return None
        return np.asarray(np.linalg.norm(one.x - two.x, axis=1))


def measure(distances: Float | None) -> tuple[float | None, float | None]:
    """Return the largest of distances (n,) and their root mean square; None if there are none, or any is not finite."""
    if distances is None or not len(distances) or not np.isfinite(distances).all():
        return None, None
    return float(distances.max()), float(np.sqrt((distances**2).mean()))


# A recording's series as plots: related columns, in convenient units.

Series = Mapping[str, NDArray[Any]]


@dataclass(frozen=True)
class Plot:
    """Lines by name, each with a value per row of `t` [s], NaN for a missing value."""

    name: str
    title: str
    unit: str
    lines: dict[str, Float]

    def to_json(self) -> dict[str, Any]:
        """Return the plot as JSON for the page, with None for values that are not finite."""
        lines = {name: [v if np.isfinite(v) else None for v in values.tolist()] for name, values in self.lines.items()}
        return {"name": self.name, "title": self.title, "unit": self.unit, "lines": lines}


@dataclass(frozen=True)
class Kind:
    """Columns of a plot: those named, or all with the prefix `start`; their values are multiplied by `scale`."""

    title: str
    unit: str
    columns: dict[str, str] = field(default_factory=dict)
    start: str = ""
    scale: float = 1.0


KINDS = {
    "stretch": Kind("Largest stretch", "%", {"stretch": ""}, scale=100.0),
    "penetration": Kind("Depth inside bodies", "mm", {"depth": "largest", "mean": "mean of those inside"}, scale=1e3),
    "crossings": Kind("Edges through cloth", "edges", {"crossings": ""}),
    "distance": Kind("Least distance of cloth from cloth", "mm", {"distance": ""}, scale=1e3),
    "wrinkles": Kind("Wrinkles", "mm", start="wrinkles_", scale=1e3),
    "force": Kind("Force on bodies", "N", start="force_"),
    "pressure": Kind("Largest pressure on bodies", "Pa", start="pressure_"),
    "mobile": Kind("Mobile dye", "full cells", start="mobile_"),
    "fixed": Kind("Fixed dye", "full cells", start="fixed_"),
}


def plots_of(series: Series) -> list[Plot]:
    """Return plots of energy, stretch, and so on, from `Recording.series`, without those that are 0 throughout."""
    plots = [_energy(series)]
    for name, kind in KINDS.items():
        columns = kind.columns or {
            one: one.removeprefix(kind.start).replace("_", " ") for one in series if one.startswith(kind.start)
        }
        lines = {text: kind.scale * series[one].astype(np.float64) for one, text in columns.items() if one in series}
        plots.append(Plot(name, kind.title, kind.unit, lines))
    plots.append(_speed(series))
    return [plot for plot in plots if any(np.nan_to_num(values).any() for values in plot.lines.values())]


def _energy(series: Series) -> Plot:
    """Return the kinds of energy that are not 0 throughout, and their sum."""
    columns = {
        name.removeprefix("energy_").replace("_", " "): v.astype(np.float64)
        for name, v in series.items()
        if name[:7] == "energy_"
    }
    lines = {name: values for name, values in columns.items() if values.any()}
    if len(lines) > 1:
        lines["total"] = np.sum(list(columns.values()), axis=0)
    return Plot("energy", "Energy", "J", lines)


def _speed(series: Series) -> Plot:
    """Return the simulated time of each frame after the first over the wall time of its steps."""
    lines = {}
    if "step_seconds" in series and "t" in series:
        seconds = series["step_seconds"].astype(np.float64)
        with np.errstate(divide="ignore", invalid="ignore"):
            lines[""] = np.where(seconds > 0.0, np.diff(series["t"], prepend=np.nan) / seconds, np.nan)
    return Plot("speed", "Speed of the solver alone", "× real time", lines)


MOST_FILMS, MOST_PAIRS, MOST_FRAMES = 6, 2, 64
"""Most films and pairs that are kept open, and most frames in one request."""
MOST_DIFFERING = 12
GONE = 410
BYTES = "application/octet-stream"


class Screen:
    """The films that pages show, of a folder's recordings.

    The page knows each by a key of the recording's name and the file's stamp: a file that was written anew is another
    film.
    """

    def __init__(self, recordings: Recordings) -> None:
        self.recordings = recordings
        self._films: dict[str, Film] = {}
        self._pairs: dict[tuple[str, str], Pair] = {}
        self._lock = threading.RLock()

    def replay(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Return the data with which the page starts the replay of a recording. Raises BadInput."""
        key, film = self._open(request.get("recording"))
        shapes = film.shape_at(film.times[-1]) + 1 if film.moves and film.times else 0
        return {
            "film": key,
            "times": [time / 1e9 for time in film.times],
            "numbers": film.numbers,
            "moves": film.moves and bool(film.times),
            "dyed": film.dyed,
            "shapes": shapes,
            "says": film.says,
        }

    def plots(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Return the plots of a film. Raises BadInput."""
        series = self._film(request.get("film")).series()
        return {"t": series.get("t", np.zeros(0)).tolist(), "plots": [plot.to_json() for plot in plots_of(series)]}

    def compare(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Return two recordings on one clock, and their distances as far as measured. Raises BadInput."""
        films = request.get("first"), request.get("second")
        if films[0] == films[1]:
            raise BadInput("a run is not compared with itself", value=films[0], remedy="choose another one")
        pair = self._pair(*map(str, films))
        return {
            "times": [time / 1e9 for time in pair.times],
            "spans": [[film.times[0] / 1e9, film.times[-1] / 1e9] for film in pair.films],
            "exact": pair.exact,
            "differs": _differing(pair.films[0].recording.scene, pair.films[1].recording.scene),
        } | pair.tell()

    def frames(self, query: Mapping[str, list[str]]) -> tuple[str, bytes]:
        """Return `count` frames of a film from number `first` on; in comparison with another film the frames of their
        clock, with the distance of each vertex from the other's. Raises Refused.
        """
        first, count = whole(query, "first"), whole(query, "count")
        key, other = (query.get(name, [""])[0] for name in ("film", "beside"))
        try:
            if not 0 < count <= MOST_FRAMES:
                raise Refused(BAD_REQUEST, f"at most {MOST_FRAMES} frames are asked for at once")
            distances: list[Float | None] = [None] * count
            film = self._film(key)
            pair = self._pair_of(key, other) if other else None
            times = (pair.times if pair else film.times)[first : first + count] if first >= 0 else []
            if not times:
                raise Refused(BAD_REQUEST, "there are no such frames")
            stills = film.stills(times)
            if pair is not None:
                distances = _distances(pair, film, stills, times)
        except BadInput as error:
            raise Refused(GONE, str(error)) from None
        return BYTES, _encode(stills, distances, pair.origin if pair is not None else film.origin)

    def shape(self, query: Mapping[str, list[str]]) -> tuple[str, bytes]:
        """Return a shape of a film's cloth by its number, and the bodies' triangles. Raises Refused."""
        try:
            film = self._film(query.get("film", [""])[0])
            shape = film.shape(whole(query, "shape"))
        except (BadInput, IndexError) as error:
            raise Refused(NOT_FOUND, str(error)) from None
        arrays = {"faces": shape.faces.astype("<u4"), "edges": shape.edges.astype("<u4"), "rest": shape.rest}
        arrays["bodyFaces"] = film.body_faces.astype("<u4")
        if shape.uv is not None:
            arrays["uv"] = shape.uv
        pieces = [{name: getattr(piece, name) for name in SAID} for piece in shape.pieces]
        panels, sewn = shape.sewn()
        arrays |= sewn
        return BYTES, pack({"panels": panels, "dyed": bool(film.recording.scene.get("dye")), "pieces": pieces}, arrays)

    def dyed(self, query: Mapping[str, list[str]]) -> tuple[str, bytes]:
        """Return a picture of dyed cloth at a frame of a film. Raises Refused."""
        try:
            film = self._film(query.get("film", [""])[0])
            return "image/png", film.picture(max(whole(query, "frame"), 0))
        except (BadInput, IndexError) as error:
            raise Refused(NOT_FOUND, str(error)) from None

    def forget(self, name: str) -> None:
        """Close the films of a recording."""
        with self._lock:
            for key in [key for key in self._films if key.partition(":")[2] == name]:
                self._close(key)

    def close(self) -> None:
        """Close all films."""
        with self._lock:
            for key in list(self._films):
                self._close(key)

    def _close(self, key: str) -> None:
        for pair in [pair for pair in self._pairs if key in pair]:
            self._pairs.pop(pair).close()
        self._films.pop(key).close()

    def _open(self, name: object) -> tuple[str, Film]:
        path = self.recordings.find(name)
        key = _key(path)
        opened = Film(path) if key not in self._films else None  # slow, so without the lock
        with self._lock:
            film = self._films.pop(key, None) or opened or Film(path)
            if opened is not None and opened is not film:
                opened.close()
            self._films[key] = film  # the most recently used
            for old in list(self._films)[:-MOST_FILMS]:
                self._close(old)
            return key, film

    def _film(self, key: object) -> Film:
        """Return a film by its key. Raises BadInput if it was closed and its file has changed."""
        with self._lock:
            film = self._films.pop(str(key), None)
            if film is not None:
                self._films[str(key)] = film  # the most recently used
                return film
        now, film = self._open(str(key).partition(":")[2])
        if now != key:
            raise BadInput("the recording has changed since", value=key, remedy="load the page again")
        return film

    def _pair(self, first: str, second: str) -> Pair:
        one, two = self._film(first), self._film(second)
        with self._lock:
            if (first, second) not in self._pairs:
                self._pairs[first, second] = Pair(one, two)
                for old in list(self._pairs)[:-MOST_PAIRS]:
                    self._pairs.pop(old).close()
            return self._pairs[first, second]

    def _pair_of(self, key: str, other: str) -> Pair:
        return next((self._pairs[names] for names in ((key, other), (other, key)) if names in self._pairs), None) or (
            self._pair(key, other)
        )


def _differing(one: Any, two: Any, path: Place = ()) -> list[tuple[str, str, str]]:
    """Return the first MOST_DIFFERING fields that differ between two scenes, with both values."""
    if isinstance(one, dict) and isinstance(two, dict):
        inside = [(key, one.get(key), two.get(key)) for key in dict.fromkeys([*one, *two])]
    elif isinstance(one, list) and isinstance(two, list) and len(one) == len(two):
        inside = [(i, *both) for i, both in enumerate(zip(one, two, strict=True))]
    else:
        a, b = ("" if part is None else flow(part) for part in (one, two))
        return [] if one == two else [(dotted(path), a, b)]
    return [row for key, a, b in inside for row in _differing(a, b, (*path, key))][:MOST_DIFFERING]


def _key(path: Path) -> str:
    try:
        return f"{'-'.join(map(str, stamp_of(path)))}:{path.name}"
    except OSError as error:
        raise BadInput(f"cannot be read: {error.strerror}", str(path)) from None


def _distances(pair: Pair, film: Film, stills: list[Still], times: list[int]) -> list[Float | None]:
    """Return the distance of each vertex from the same vertex of the other film [m]."""
    other = pair.films[1] if film is pair.films[0] else pair.films[0]
    theirs = other.stills(times)
    ordered = (stills, theirs) if film is pair.films[0] else (theirs, stills)
    return [pair.distances(one, two) for one, two in zip(*ordered, strict=True)]


def _encode(stills: list[Still], distances: list[Float | None], origin: Float) -> bytes:
    """Pack arrays x, body and far of each frame, with the frame's index in their names; body only if it has moved."""
    arrays, heads = {}, []
    for i, (still, apart) in enumerate(zip(stills, distances, strict=False)):
        arrays[f"x{i}"] = about(still.x, origin)
        if i == 0 or not np.array_equal(still.body, stills[i - 1].body):
            arrays[f"body{i}"] = about(still.body, origin)
        if apart is not None:
            arrays[f"far{i}"] = apart.astype("<f4")
        heads.append({"t": still.t, "frame": still.frame, "shape": still.shape, "between": still.between})
    return pack({"origin": origin.tolist(), "frames": heads}, arrays)
