"""What a run came to, and how it shows itself in a notebook."""

from __future__ import annotations

import base64
import io
import shutil
import weakref
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nuno.api.recordings import export
from nuno.process import scratch
from nuno.recording.reader import Recording, open_recording
from nuno.report.make import Report
from nuno.report.show import lines
from nuno_schemas.errors import BadInput, nearest
from nuno_schemas.fabric import Float

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from pandas import DataFrame
    from PIL.Image import Image


class Folder:
    """A folder that goes with whoever refers to it, at the latest when Python ends."""

    def __init__(self, path: Path) -> None:
        self.path = path
        weakref.finalize(self, shutil.rmtree, path, ignore_errors=True)


@dataclass(frozen=True)
class Result:
    """A finished run.

    x (n, 3) [m] and v (n, 3) [m/s] are the last state, float64; of a cloth that is dyed phi and fixed
    (2, ny, nx), or (dyes, 2, ny, nx) for several dyes, and no vertices where it is dyed alone. digest is
    that of the state, of a dyed garment of its vertices. report is what the command line prints;
    recording is the file with every frame, at `path`. Unless a file was asked for, it is a temporary one: it is
    removed when neither this result nor a `recording` of it is referred to any more.
    """

    state: str
    t: float
    x: Float
    v: Float
    digest: str
    report: Report
    path: Path
    phi: Float | None = None
    fixed: Float | None = None
    folder: Folder | None = field(default=None, repr=False, compare=False)

    @property
    def recording(self) -> Recording:
        """The recording, opened anew."""
        found = open_recording(self.path)
        found.owner = self.folder
        return found

    def to_dataframe(self) -> DataFrame:
        """Energy, stretch, penetration, dye, step time, ...: a row a frame, the columns of `Recording.series`.

        Raises BadInput without pandas.
        """
        with self.recording as recording:
            return table_of(recording.series())

    def plot(self, *names: str | Sequence[str]) -> Axes:
        """Series over time, on axes of matplotlib: columns of `to_dataframe`, or what several begin with, as "energy".

        Unless named, it is the energy, or of a cloth that is dyed alone what is mobile and what is fixed.
        Raises BadInput for what is no series, and without matplotlib.
        """
        try:
            from matplotlib import pyplot
        except ImportError:
            raise missing("a plot", "matplotlib") from None
        from nuno.exports.tables import heading

        with self.recording as recording:
            series, own = recording.series(), ("mobile", "fixed") if recording.dyed_alone else ("energy",)
        known = [name for name in series if name not in ("t", "frame")]
        groups = sorted({*known, *(name.split("_")[0] for name in known)})
        wanted = list[str]()
        asked = [one for name in names for one in ([name] if isinstance(name, str) else name)]
        for name in asked or own:
            found = [one for one in known if one == name or one.startswith(f"{name}_")]
            if not found:
                raise BadInput("no such series", field="names", value=name, remedy=nearest(str(name), groups))
            wanted += found
        axes: Axes = pyplot.subplots(layout="constrained")[1]
        for name in wanted:
            axes.plot(series["t"], series[name], label=heading(name))
        axes.set_xlabel("t [s]")
        axes.legend(frameon=False)
        return axes

    def picture(
        self, side: str | None = None, frame: int | None = None, *overrides: str | Mapping[str, Any], **how: Any
    ) -> Image:
        """A frame (default: the last) as an image of Pillow, which notebooks show.

        side: front, left, back, right, close (the cloth fills the picture), or None for the scene's own camera;
        `overrides` and `how` as `export` takes them for a png: "view.elevation=20deg", colour="stretch",
        size=(640, 480). Raises BadInput.
        """
        from PIL import Image

        with scratch() as folder:
            (path,) = export(self, *overrides, png=folder / "picture.png", frame=frame, side=side, **how)
            with Image.open(path) as image:
                image.load()
                return image

    def show(self) -> None:
        """The whole run in rerun's viewer, within a notebook. Raises BadInput where that is not installed."""
        try:
            import rerun_notebook  # noqa: F401
        except ImportError:
            raise missing("the viewer in a notebook", "'nuno[notebook]'") from None
        import rerun as rr

        with scratch() as folder:
            (path,) = export(self, rrd=folder / "run.rrd")
            stream = rr.RecordingStream("nuno", recording_id=self.path.stem)
            stream.log_file_from_path(path)
            stream.notebook_show()

    def _repr_html_(self) -> str:
        """The last frame, and what the report says, for a notebook."""
        data = io.BytesIO()
        self.picture().save(data, "PNG")
        image = base64.b64encode(data.getvalue()).decode()
        rows = "".join(f"<tr><th>{escape(name)}</th><td>{escape(text)}</td></tr>" for name, text in lines(self.report))
        return (
            f'<img alt="the last frame" style="max-width: 640px" src="data:image/png;base64,{image}">'
            f"<details><summary>{self.state} at {self.t:g} s</summary><table>{rows}</table></details>"
        )


def table_of(data: Any) -> DataFrame:
    """Columns by name, or a list of rows. Raises BadInput without pandas."""
    try:
        from pandas import DataFrame
    except ImportError:
        raise missing("a table", "pandas") from None
    return DataFrame(data)


def missing(what: str, package: str) -> BadInput:
    """What is said where a package is not installed."""
    return BadInput(f"{what} needs {package}", remedy=f"pip install {package}")
