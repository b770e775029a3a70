"""Layout of the viewer's window, and its eye."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from nuno_schemas.fabric import Float
from nuno_schemas.scene import View

TIMELINE, DYE_TIMELINE, PICTURE = "sim_time", "dye_time", "/dye/picture"
"""Timelines of the scene, and of the dyeing in scenes of dye alone; entity of the dyed cloth's picture."""
YARNS = "/render/yarns"
"""Entity of ray-traced pictures of yarns."""
LEGEND = "/legend"
"""Entity of the colour scale of tension."""
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
BACKGROUND, LINES = [226, 230, 234], [120, 126, 134, 90]
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


def arrange(
    eye: Eye, bodies: bool, play: Play, dyes: list[str] | None = None, pictures: bool = False, legend: bool = False,
    meets: bool = False, ground: bool = False, felt: bool = False,
) -> Any:  # fmt: skip
    """Return the blueprint: the scene large on the left, with the `legend` of its links' tension below and the
    `pictures` of its yarns next to it, if any; curves, log and report on the right. `meets`: cloth collides with cloth.
    A scene without a `ground` has a grid below it. `felt`: contact forces on bodies are shown.
    """
    plots = [curves("Energy [J]", "energy", legend=True), curves("Largest stretch [%]", "stretch")]
    if bodies:
        plots.append(curves("Penetration [mm]", "penetration", legend=True))
    if felt:
        plots.append(curves("Force on bodies [N]", "contact", legend=True))
    if meets:
        plots.append(curves("Least distance of cloth from cloth [mm]", "distance"))
    plots.append(curves("Wall time to compute a frame [ms]", "time"))
    amounts = [curves(f"{name} [full cells]", f"dye/{name}", legend=True) for name in dyes or ()]
    tabs = [*([("Dye", amounts)] if amounts else []), ("Curves", plots)]
    scene: Any = rrb.Spatial3DView(
        name="Scene",
        origin="/world",
        background=rrb.Background(color=BACKGROUND),
        line_grid=rrb.LineGrid3D(
            visible=not ground, spacing=GRID, plane=rr.components.Plane3D([0.0, 1.0, 0.0], eye.lowest), color=LINES
        ),
        eye_controls=rrb.EyeControls3D(
            kind=rrb.Eye3DKind.Orbital, position=eye.position, look_target=eye.target, eye_up=[0, 1, 0]
        ),
    )
    if legend:
        scale = rrb.Spatial2DView(
            name="Tension along the yarns", origin=LEGEND, background=rrb.Background(color=BACKGROUND)
        )
        scene = rrb.Vertical(scene, scale, row_shares=[9.0, 1.0])
    main = scene if not pictures else rrb.Horizontal(scene, rrb.Spatial2DView(name="Yarns", origin=YARNS))
    return _blueprint(main, [rrb.Vertical(*part, name=name) for name, part in tabs], play)


def arrange_dyed(dyes: list[str], shape: tuple[int, int], duration: float, play: Play) -> Any:
    """Return the blueprint of a dyed cloth: its picture large on the left, curves of each dye on the right.

    `shape` is that of the picture [pixels]. Curves show the whole `duration` of the dyeing [s], which is played within
    PLAY_SECONDS: rerun's defaults show a minute, and play for hours.
    """
    amounts = [curves(f"{name} [full cells]", f"dye/{name}", legend=True, duration=duration) for name in dyes]
    time = curves("Wall time to compute a frame [ms]", "time", duration=duration)
    plots = [*amounts, time] if len(dyes) < MOST_ROWS else [rrb.Tabs(*amounts, name="Amounts"), time]
    picture = rrb.Spatial2DView(
        name="Cloth",
        origin=PICTURE,
        background=rrb.Background(color=BACKGROUND),
        visual_bounds=rrb.VisualBounds2D(x_range=(0, shape[1]), y_range=(0, shape[0])),
    )
    return _blueprint(
        picture, [rrb.Vertical(*plots, name="Curves")], play, DYE_TIMELINE, max(1.0, duration / PLAY_SECONDS)
    )


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


def _blueprint(main: Any, plots: list[Any], play: Play, timeline: str = TIMELINE, speed: float = 1.0) -> Any:
    side = rrb.Tabs(
        *plots,
        rrb.TextDocumentView(name="About", origin="/about"),
        rrb.TextLogView(name="Log", origin="/log"),
        rrb.TextDocumentView(name="Report", origin="/report"),
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


def names(labels: list[str], widths: list[float] | None = None) -> Any:
    """Return names and colours of a plot's curves; a curve named "total" is grey."""
    colours = [TOTAL if label == "total" else CURVES[i % len(CURVES)] for i, label in enumerate(labels)]
    return rr.SeriesLines(names=labels, colors=colours, widths=widths or [2.0] * len(labels))


def number(value: float | None) -> float:
    """Return NaN for null, which stands for an infinite value in messages; curves have a gap there."""
    return math.nan if value is None else value
