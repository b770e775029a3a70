"""Runs, from a script or a notebook, and their results."""

from __future__ import annotations

import contextlib
import os
import shutil
import sys
import tempfile
import warnings
import weakref
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from nuno.plugin_contract import registry
from nuno.process import SIGNALS, scratch
from nuno.python_api.plan import keep_up
from nuno.python_api.recordings import Recorded, export, path_of
from nuno.python_api.scene import Scene, as_texts, in_python, loaded
from nuno.recording.reader import Recording, open_recording
from nuno.recording.recorded import per_dye
from nuno.recording.writer import part_of
from nuno.report.run_report import Report, lines, make_report
from nuno.runtime import runs, supervisor
from nuno.runtime.service import Options
from nuno.runtime.supervisor import Deployment, Progress
from nuno.scene.recorded_scene import resumed_scene
from nuno.scene.scene_file import Loaded
from nuno.simulation.solver_selection.cloth import decide
from nuno_schemas.errors import BadInput, RunFailed, nearest
from nuno_schemas.fabric import Float
from nuno_schemas.messages import DYE_CHECKPOINT

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from pandas import DataFrame
    from PIL.Image import Image


def run(
    scene: str | os.PathLike[str] | Mapping[str, Any] | Scene,
    *overrides: str | Mapping[str, Any],
    record: str | os.PathLike[str] | None = None,
    roots: Sequence[str | os.PathLike[str]] = (),
    processes: bool = False,
    threads: int = 0,
    progress: bool | None = None,
    real_time: bool = False,
    **fields: Any,
) -> Result:
    """Simulate a scene: a file, the name of a shipped scene, a mapping of its fields, or a `Scene`.

    `overrides` change it: "key=value" as after --set, or mappings of such keys to values; `fields` are the scene's own
    except `record`, by keyword: nuno.run("hanging-sheet", {"solver.plugin": "rk4"}, duration="2 s"). `record` is the
    recording's file (default: a temporary one, removed with the result). `progress`: whether to show a progress bar;
    None shows it on a terminal or in a notebook. `real_time`: whether frames wait for the clock.

    Warns (UserWarning) of a doubtful scene or start.
    Raises BadInput for a bad scene, RunFailed for a run that failed or diverged, and KeyboardInterrupt for one that a
    signal ended; the recording of both is kept.
    """
    with in_python(), loaded(scene, as_texts([*overrides, fields]), roots) as scene_loaded:
        decided = keep_up(scene_loaded) if real_time or scene_loaded.paced else decide(scene_loaded)
        options = Options(record=_path(record), threads=threads, real_time=real_time)
        return _run(decided, options, processes, progress)


def resume(
    recording: Recorded,
    *overrides: str | Mapping[str, Any],
    record: str | os.PathLike[str] | None = None,
    processes: bool = False,
    threads: int = 0,
    progress: bool | None = None,
    **fields: Any,
) -> Result:
    """Resume the last checkpoint of a recording, with its own scene, whose duration, record and view may change:
    nuno.resume("last", duration="8 s"). The rest is as in `run`. The new recording begins with the old one's frames.

    Raises BadInput also for a recording without a checkpoint, or of a complete run.
    """
    with in_python(), resumed_scene(path := path_of(recording), as_texts([*overrides, fields])) as (scene_loaded, _):
        options = Options(record=_path(record), threads=threads, resume=path)
        return _run(decide(scene_loaded), options, processes, progress)


def run_loaded(scene: Loaded, record: Path, threads: int = 0) -> Result:
    """Simulate a loaded scene. Raises as `run`."""
    return _run(decide(scene), Options(record=record, threads=threads, temporary=True), False, False)


def _path(record: str | os.PathLike[str] | None) -> Path | None:
    try:
        return None if record is None else Path(record)
    except TypeError:
        raise BadInput(
            "a recording is a file", field="--record", value=record, limit="a path that ends in .mcap"
        ) from None


def _run(scene: Loaded, options: Options, processes: bool, progress: bool | None) -> Result:
    if processes:
        registry.require_installed(scene.chosen, "other processes", "leave processes=True out")
    deployment = Deployment(processes=processes, run=runs.new_id(scene.scene.name))
    if options.record is not None:
        return _recorded(scene, options, deployment, progress)
    folder = Path(tempfile.mkdtemp(prefix="nuno-"))
    path = folder / f"{deployment.run}.mcap"
    try:
        options = replace(options, record=path, temporary=True)
        return replace(_recorded(scene, options, deployment, progress), folder=Folder(folder))
    except BaseException:
        if not any(folder.iterdir()):
            shutil.rmtree(folder, ignore_errors=True)
        raise


@contextlib.contextmanager
def _progress_bar(scene: Loaded, progress: bool | None) -> Iterator[Progress | None]:
    """Yield the function that updates a progress bar, None without one; by default it is on a terminal or in a
    notebook.
    """
    if progress is None:
        shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
        progress = sys.stderr.isatty() or "IPKernelApp" in getattr(shell, "config", {})
    if not progress:
        yield None
        return
    from nuno.python_api.progress import ProgressLine

    with ProgressLine(scene.scene, bar=True) as line:
        yield line.update


def _recorded(scene: Loaded, options: Options, deployment: Deployment, progress: bool | None) -> Result:
    path = options.record
    assert path is not None
    with _progress_bar(scene, progress) as update:
        outcome = supervisor.supervise(scene, options, deployment, update, lambda o: make_report(scene, o))
    path = outcome.recording(path) or part_of(path)
    report = make_report(scene, outcome)
    for text in report["warnings"]:
        warnings.warn(text, stacklevel=4)  # at the caller of `run`
    if outcome.error in SIGNALS:
        # The signal stops the caller as anywhere else: a loop over scenes does not go on with the next.
        raise KeyboardInterrupt(f"{outcome.error}; recording kept in {path}")
    if outcome.problem:
        raise RunFailed(f"{outcome.problem}; recording kept in {path}")
    digest = outcome.summary["digest"]
    x = v = np.zeros((0, 3))
    t, amounts = 0.0, dict[str, Float]()
    with open_recording(path) as recording:
        if scene.scene.moves:
            last = recording.last_checkpoint()
            t, x, v = last.t, np.array(last.x), np.array(last.v)
        if scene.dye is not None:
            end = recording.last_checkpoint(topic=DYE_CHECKPOINT.name)
            t, amounts = end.t, {name: np.array(per_dye(values)) for name, values in end.state.items()}
    return Result(outcome.state, t, x, v, digest, report, path, amounts.get("phi"), amounts.get("fixed"))


# The result of a run, and its display in a notebook.


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

        from nuno.viewer.stream import application

        with scratch() as folder, self.recording as recording:
            (path,) = export(self, rrd=folder / "run.rrd")
            stream = rr.RecordingStream(application(recording.scene), recording_id=self.path.stem)
            stream.log_file_from_path(path)
            stream.notebook_show()

    def _repr_html_(self) -> str:
        """Return the last frame and the report as HTML, for a notebook."""
        from nuno.exports.cloth import as_url

        image = as_url(np.asarray(self.picture()))
        rows = "".join(f"<tr><th>{escape(name)}</th><td>{escape(text)}</td></tr>" for name, text in lines(self.report))
        return (
            f'<img alt="the last frame" style="max-width: 640px" src="{image}">'
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
