"""Layout of the viewer's window, and its eye."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from nuno.viewer.fields import BACKGROUND, QUANTITIES, ordered
from nuno_schemas.fabric import Float
from nuno_schemas.messages import DyeStatus, Status
from nuno_schemas.scene import View

TIMELINE, DYE_TIMELINE, PICTURE = "sim_time", "dye_time", "picture"
"""Timelines of the scene, and of the dyeing in scenes of dye alone; entity of the dyed cloth's picture."""
YARNS = "/render/yarns"
"""Entity of ray-traced pictures of yarns."""
EXTRAS = ("contact", "pins")
"""What of a scene is hidden at first: points of contact with bodies and their forces, and pins."""
HALF_VIEW = 0.5 * np.radians(58.0)
"""About half of rerun's vertical field of view."""

CURVES = [[230, 159, 0], [86, 180, 233], [0, 158, 115], [204, 121, 167], [240, 228, 66], [213, 94, 0]]
"""Colours that are distinguishable with the common colour-vision deficiencies (Okabe and Ito, 2008)."""
TOTAL = [128, 128, 128]
"""Grey that is visible on the dark and the light theme."""
PLAY_SECONDS = 10.0
Play = Literal["following", "playing", "looping"]
"""What the time does: it follows the newest frame, or plays from the start, once or again and again."""
MOST_ROWS = 4
"""Most plots of dyes in a column; more are put into tabs."""
LINES = [120, 126, 134, 90]
GRID = 0.1
"""Spacing of the floor's lines [m]."""


@dataclass(frozen=True)
class Eye:
    """Position and target of the viewer's eye, (3,) [m], and the height of the lowest point [m]."""

    position: Float
    target: Float
    lowest: float = 0.0


def stage(cloth: Float, pinned: NDArray[np.bool_], bodies: Float) -> Float:
    """Return points (n, 3) that should be in view, from the first frame of cloth and bodies.

    Pinned cloth may swing down: as far below its pins as it extends from them at first.
    """
    if not pinned.any():
        return np.concatenate([cloth, bodies])
    pin = cloth[pinned].mean(axis=0)
    reach = float(np.linalg.norm(cloth - pin, axis=1).max())
    return np.concatenate([cloth, [pin - [0.0, reach, 0.0]], bodies])


def fit_eye(points: Float, view: View) -> Eye:
    """Fit an eye to the sphere around all finite points (n, 3), y up; fields of the scene's view take precedence."""
    cloud = points[np.isfinite(points).all(axis=1)]
    if not len(cloud):
        cloud = np.array([[-0.5, -0.5, -0.5], [0.5, 0.5, 0.5]])
    middle = 0.5 * (cloud.min(axis=0) + cloud.max(axis=0))
    target = middle if view.target is None else np.array(view.target)
    radius = float(np.linalg.norm(cloud - target, axis=1).max()) or 0.5
    distance = radius / np.sin(HALF_VIEW) if view.distance is None else view.distance
    level = np.cos(view.elevation)
    toward = np.array([np.sin(view.azimuth) * level, np.sin(view.elevation), np.cos(view.azimuth) * level])
    return Eye(target + distance * toward, target, float(cloud[:, 1].min()))


@dataclass
class Window:
    """What the window shows besides the scene's cloth.

    bodies    whether there are bodies, and `ground` whether any is drawn as the ground: a scene without has a grid
    meets     whether cloth collides with cloth, and `felt` whether contact forces on bodies are recorded
    counted   whether solvers count something
    pictures  whether there are pictures of yarns
    dyes      names of the dyes
    fields    how each field colours cloth: the visualizer of each path
    active    the field of the first tab to be seen; "" for the cloth's own look
    apart     whether compared runs have a distance from the first
    runs      names of compared recordings, whose entities are below one of that name; empty for one recording
    hidden    paths of bodies that are not drawn, since another run's are at the same place
    """

    bodies: bool = False
    ground: bool = False
    meets: bool = False
    felt: bool = False
    counted: bool = False
    pictures: bool = False
    apart: bool = False
    dyes: list[str] = field(default_factory=list)
    fields: dict[str, dict[str, Any]] = field(default_factory=dict)
    active: str = ""
    runs: list[str] = field(default_factory=list)
    hidden: list[str] = field(default_factory=list)


class Entities:
    """Entities of one recording in the rerun stream `recording`; of a `run` that is compared with others below an
    entity of its name, with curves of its `colour`.
    """

    def __init__(self, recording: Any, run: str = "", colour: Sequence[int] | None = None) -> None:
        self.recording, self.run, self.colour = recording, run, colour
        self._run = [run] if run else []

    def log(self, path: str, *what: Any, static: bool = False) -> None:
        """Log something at the present time, or `static`. Raises an error for what rerun does not take."""
        self.recording.log(path, *what, static=static, strict=True)

    def world(self, *parts: str) -> str:
        """Return the path of something in the scene."""
        return entity("world", *self._run, *parts)

    def plot(self, *parts: str) -> str:
        """Return the path of a curve."""
        return entity("plots", *parts, *self._run)

    def page(self, name: str) -> str:
        """Return the path of the log, the report, the explanation, or the picture of dye."""
        return entity(name, *self._run)

    def show_page(self, name: str, markdown: str) -> None:
        """Set the text of the report or the explanation."""
        self.log(self.page(name), rr.TextDocument(markdown, media_type="text/markdown"), static=True)

    def tell(self, text: str, level: str) -> None:
        """Add a line to the log."""
        self.log(self.page("log"), rr.TextLog(text, level=level))

    def tell_message(self, status: Status | DyeStatus) -> None:
        """Add the message of a frame's status to the log, if it has one."""
        if status.message:
            self.tell(status.message, "INFO" if status.state == "running" else "WARN")

    def name_curves(self, plot: str, curves: Sequence[str], widths: Sequence[float] = ()) -> None:
        """Name and colour the curves of a plot, each an entity of its own: PLOT/CURVE; a curve named "total" is grey.
        Those of compared runs have the run's colour, and are thinner after the first.
        """
        for i, name in enumerate(curves):
            colour, width = TOTAL if name == "total" else CURVES[i % len(CURVES)], widths[i] if widths else 2.0
            if self.colour is not None:
                colour, width = list(self.colour), 2.0 if i == 0 or name == "total" else 1.0
            series = rr.SeriesLines(names=", ".join([name, *self._run]), colors=colour, widths=width)
            self.log(self.plot(*plot.split("/", 1), name), series, static=True)

    def log_values(self, plot: str, values: Mapping[str, float]) -> None:
        """Log the present value of each curve of a plot."""
        for name, value in values.items():
            self.log(self.plot(*plot.split("/", 1), name), rr.Scalars(value))


def legend(field: str) -> str:
    """Return the entity of a field's colour scale."""
    return entity("legend", field)


def arrange(eye: Eye, window: Window, play: Play) -> Any:
    """Return the blueprint: the scene large on the left, with a tab for the cloth's own look and one for each field,
    with its legend below; curves, log and report on the right.
    """
    views: list[Any] = [_scene(eye, window, "Cloth", {})]
    names = ordered(list(window.fields))
    for name in names:
        scale = rrb.Spatial2DView(
            name=QUANTITIES[name].title, origin=legend(name), background=rrb.Background(color=BACKGROUND)
        )
        scene = _scene(eye, window, name.capitalize(), window.fields[name])
        views.append(rrb.Vertical(scene, scale, row_shares=[9.0, 1.0], name=name.capitalize()))
    active = names.index(window.active) + 1 if window.active in names else 0
    main = rrb.Tabs(*views, active_tab=active, name="Scene") if len(views) > 1 else views[0]
    if window.pictures:
        main = rrb.Horizontal(main, rrb.Spatial2DView(name="Yarns", origin=YARNS))
    return _blueprint(main, _plots(window), play, runs=window.runs)


def _scene(eye: Eye, window: Window, name: str, coloured: dict[str, Any]) -> Any:
    """Return a view of the scene, in which visualizers by path change the look of cloth. Points of contact, its forces
    and pins are there, and hidden.
    """
    hidden = [entity("world", *run, what) for run in ([[r] for r in window.runs] or [[]]) for what in EXTRAS]
    out_of_sight = {path: rrb.EntityBehavior(visible=False) for path in hidden}
    return rrb.Spatial3DView(
        name=name,
        origin="/world",
        contents=["$origin/**", *(f"- {path}/**" for path in window.hidden)],
        overrides={**out_of_sight, **coloured},
        background=rrb.Background(color=BACKGROUND),
        line_grid=rrb.LineGrid3D(
            visible=not window.ground, spacing=GRID, plane=rr.components.Plane3D([0.0, 1.0, 0.0], eye.lowest),
            color=LINES,
        ),
        eye_controls=rrb.EyeControls3D(
            kind=rrb.Eye3DKind.Orbital, position=eye.position, look_target=eye.target, eye_up=[0, 1, 0]
        ),
    )  # fmt: skip


def _plots(window: Window) -> list[Any]:
    """Return the tabs of curves."""
    several = bool(window.runs)
    # Of compared runs the energy's total alone: its parts are there for who adds them.
    energy = curves("Total energy from the start [J]", "energy/total", legend=True) if several else curves(
        "Energy, of gravity from the start [J]", "energy", legend=True)  # fmt: skip
    plots = [energy, curves("Largest stretch [%]", "stretch", legend=several)]
    if window.apart:
        plots.append(curves("Distance from the first recording [mm]", "difference", legend=True))
    if window.bodies:
        plots.append(curves("Penetration [mm]", "penetration", legend=True))
    if window.felt:
        plots.append(curves("Force on bodies [N]", "contact", legend=True))
    if window.meets:
        plots.append(curves("Least distance of cloth from cloth [mm]", "distance", legend=True))
    plots.append(curves("Wall time to compute a frame [ms]", "time", legend=several))
    tabs = [rrb.Vertical(*plots, name="Curves")]
    if window.dyes:
        amounts = [curves(f"{name} [full cells]", f"dye/{name}", legend=True) for name in window.dyes]
        tabs.insert(0, rrb.Vertical(*amounts, name="Dye"))
    if window.counted:
        tabs.append(rrb.Vertical(curves("Counts of a frame", "counts", legend=True), name="Counts"))
    return tabs


def arrange_dyed(dyes: list[str], shape: tuple[int, int], duration: float, play: Play, runs: Sequence[str] = ()) -> Any:
    """Return the blueprint of a dyed cloth: its picture large on the left, curves of each dye on the right; of compared
    `runs` a picture each.

    `shape` is that of the pictures [pixels]. Curves show the whole `duration` of the dyeing [s], which is played within
    PLAY_SECONDS: rerun's defaults show a minute, and play for hours.
    """
    amounts = [curves(f"{name} [full cells]", f"dye/{name}", legend=True, duration=duration) for name in dyes]
    time = curves("Wall time to compute a frame [ms]", "time", legend=bool(runs), duration=duration)
    front = curves("Radius of a disc as large as the dyed area [mm]", "front", legend=True, duration=duration)
    plots = [*amounts, front, time] if len(dyes) < MOST_ROWS else [rrb.Tabs(*amounts, name="Amounts"), front, time]
    pictures = [
        rrb.Spatial2DView(
            name=run or "Cloth",
            origin=entity(*filter(None, (PICTURE, run))),
            background=rrb.Background(color=BACKGROUND),
            visual_bounds=rrb.VisualBounds2D(x_range=(0, shape[1]), y_range=(0, shape[0])),
        )
        for run in runs or [""]
    ]
    main = pictures[0] if len(pictures) == 1 else rrb.Grid(*pictures)
    tabs, speed = [rrb.Vertical(*plots, name="Curves")], max(1.0, duration / PLAY_SECONDS)
    return _blueprint(main, tabs, play, DYE_TIMELINE, speed, runs)


def curves(name: str, what: str, legend: bool = False, duration: float | None = None) -> Any:
    """Return a plot of the entity `what` below /plots, from the start to `duration` [s] if given."""
    time_axis = None
    if duration is not None:
        start, end = (rrb.TimeRangeBoundary.absolute(seconds=t) for t in (0.0, duration))
        time_axis = rrb.TimeAxis(view_range=rrb.TimeRange(start=start, end=end))
    return rrb.TimeSeriesView(
        name=name,
        origin=entity("plots", *what.split("/", 1)),
        axis_x=time_axis,
        plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop, visible=legend),
    )


def _blueprint(
    main: Any, plots: list[Any], play: Play, timeline: str = TIMELINE, speed: float = 1.0, runs: Sequence[str] = ()
) -> Any:
    pages = [(f"Report of {run}", entity("report", run)) for run in runs] or [("Report", "/report")]
    side = rrb.Tabs(
        *plots,
        *([] if runs else [rrb.TextDocumentView(name="About", origin="/about")]),
        rrb.TextLogView(name="Log", origin="/log"),
        *(rrb.TextDocumentView(name=name, origin=origin) for name, origin in pages),
        active_tab=0,
    )
    return rrb.Blueprint(
        rrb.Horizontal(main, side, column_shares=[2.4, 1.0]),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(
            state="collapsed",
            timeline=timeline,
            playback_speed=speed,
            play_state="playing" if play == "looping" else play,
            loop_mode="all" if play == "looping" else None,
        ),
        auto_views=False,
        auto_layout=False,
    )


def set_time(recording: Any, frame: int, t: float) -> None:
    """Set the time of the following log calls: a frame at t [s] of the scene."""
    recording.set_time("frame", sequence=frame)
    recording.set_time(TIMELINE, duration=t)


def entity(*parts: str) -> str:
    """Return a path in rerun of names with any characters."""
    return "/" + str(rr.new_entity_path(list(parts))).lstrip("/")


def number(value: float | None) -> float:
    """Return NaN for null, which stands for an infinite value in messages; curves have a gap there."""
    return math.nan if value is None else value
