"""The result of a run, and its display in a notebook."""

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

from nuno.api.recordings import export, path_of
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
    """A temporary folder, removed with the last reference to it, at the latest when Python ends."""

    def __init__(self, path: Path) -> None:
        self.path = path
        weakref.finalize(self, shutil.rmtree, path, ignore_errors=True)


@dataclass(frozen=True)
class Result:
    """A finished run.

    x (n, 3) [m] and v (n, 3) [m/s] are the last state, float64; dyed cloth has phi and fixed
    (2, ny, nx), or (dyes, 2, ny, nx) for several dyes, and without motion no vertices. digest is
    that of the state, for a dyed garment of its vertices. report is the one that the command line prints;
    recording is the file with every frame, at `path`. By default it is temporary, and
    removed with the last reference to this result or a `recording` of it.
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
        """The recording, newly opened. Raises BadInput if the file is now the recording of another run."""
        opened = open_recording(path_of(self))
        opened.owner = self.folder
        return opened

    def to_dataframe(self) -> DataFrame:
        """Return energy, stretch, penetration, dye, step time, ...: a row a frame, the columns of `Recording.series`.

        Raises BadInput without pandas.
        """
        with self.recording as recording:
            return table_of(recording.series())

    def plot(self, *names: str | Sequence[str]) -> Axes:
        """Plot series over time with matplotlib: columns of `to_dataframe`, or a common prefix, as "energy".

        The default is the energy, or for dye without motion the mobile and the fixed amounts.
        Raises BadInput for an unknown series, and without matplotlib.
        """
        try:
            from matplotlib import pyplot
        except ImportError:
            raise missing("a plot", "matplotlib") from None
        from nuno.exports.tables import heading

        with self.recording as recording:
            series, default = recording.series(), ("mobile", "fixed") if recording.dyed_alone else ("energy",)
        series_names = [name for name in series if name not in ("t", "frame")]
        groups = sorted({*series_names, *(name.split("_")[0] for name in series_names)})
        wanted = list[str]()
        requested = [each for name in names for each in ([name] if isinstance(name, str) else name)]
        for name in requested or default:
            matches = [each for each in series_names if each == name or each.startswith(f"{name}_")]
            if not matches:
                raise BadInput("no such series", field="names", value=name, remedy=nearest(str(name), groups))
            wanted += matches
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
        """Show the whole run in rerun's viewer, in a notebook. Raises BadInput where that is not installed."""
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
        """Return the last frame and the report as HTML, for a notebook."""
        data = io.BytesIO()
        self.picture().save(data, "PNG")
        image = base64.b64encode(data.getvalue()).decode()
        rows = "".join(f"<tr><th>{escape(name)}</th><td>{escape(text)}</td></tr>" for name, text in lines(self.report))
        return (
            f'<img alt="the last frame" style="max-width: 640px" src="data:image/png;base64,{image}">'
            f"<details><summary>{self.state} at {self.t:g} s</summary><table>{rows}</table></details>"
        )


def table_of(data: Any) -> DataFrame:
    """Return a table of columns by name, or of a list of rows. Raises BadInput without pandas."""
    try:
        from pandas import DataFrame
    except ImportError:
        raise missing("a table", "pandas") from None
    return DataFrame(data)


def missing(what: str, package: str) -> BadInput:
    """Return the error for a package that is not installed."""
    return BadInput(f"{what} needs {package}", remedy=f"pip install {package}")
