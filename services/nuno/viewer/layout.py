"""How the viewer's window is arranged, and where its eye stands."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from nuno_schemas.fabric import Float
from nuno_schemas.view import View

TIMELINE, DYE_TIMELINE, PICTURE = "sim_time", "dye_time", "/dye/picture"
"""Time of the scene; that of the dyeing, where there is nothing but a cloth that is dyed."""
YARNS = "/render/yarns"
"""Pictures of yarns by rays."""
LEGEND = "/legend"
"""The scale of the colours of tension."""
HALF_VIEW = 0.5 * np.radians(58.0)
"""About half of rerun's vertical field of view."""

CURVES = [[230, 159, 0], [86, 180, 233], [0, 158, 115], [204, 121, 167], [240, 228, 66], [213, 94, 0]]
"""Colours told apart with the common colour-vision deficiencies (Okabe and Ito, 2008)."""
TOTAL = [128, 128, 128]
"""To be seen on the dark and the light theme."""
PLAY_SECONDS = 10.0
MOST_ROWS = 4
"""Plots of dyes below each other; more of them are behind tabs."""
BACKGROUND, LINES = [226, 230, 234], [120, 126, 134, 90]
GRID = 0.1
"""From one line of the floor to the next [m]."""


@dataclass(frozen=True)
class Eye:
    """Where the viewer looks from and at, (3,) [m], and the height of the lowest that there is [m]."""

    position: Float
    target: Float
    lowest: float = 0.0


def stage(cloth: Float, pinned: NDArray[np.bool_], bodies: Float) -> Float:
    """Points (n, 3) that should be in view, from the first frame of cloth and bodies.

    Cloth that is pinned stays about there, but may swing down: as far below its pins as it reaches now.
    """
    if not pinned.any():
        return np.concatenate([cloth, bodies])
    pin = cloth[pinned].mean(axis=0)
    reach = float(np.linalg.norm(cloth - pin, axis=1).max())
    return np.concatenate([cloth, [pin - [0.0, reach, 0.0]], bodies])


def fit_eye(points: Float, view: View) -> Eye:
    """An eye that has the ball round all finite points (n, 3) in view, y up; the scene's view wins."""
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
    eye: Eye, bodies: bool, live: bool, dyes: list[str] | None = None, pictures: bool = False, legend: bool = False,
    meets: bool = False, ground: bool = False, felt: bool = False,
) -> Any:  # fmt: skip
    """The blueprint: the scene large on the left, with the `legend` of its links' tension below and the `pictures` of
    its yarns beside it, if any; curves, log and report on the right. `meets`: cloth meets cloth. What stands on no
    `ground` of its own has a grid below it. `felt`: it is told what bodies feel.
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
    return _blueprint(main, [rrb.Vertical(*part, name=name) for name, part in tabs], live)


def arrange_dyed(dyes: list[str], shape: tuple[int, int], duration: float, live: bool) -> Any:
    """The blueprint of a dyed cloth: its picture large on the left; curves of each dye beside it.

    `shape` is that of the picture [pixels]. Curves show all of the dyeing's `duration` [s], which is played within
    PLAY_SECONDS: by themselves they would show a minute, and play hours.
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
        picture, [rrb.Vertical(*plots, name="Curves")], live, DYE_TIMELINE, max(1.0, duration / PLAY_SECONDS)
    )


def curves(name: str, what: str, legend: bool = False, duration: float | None = None) -> Any:
    """A plot of what is logged below /plots, from the start to `duration` [s] where it is given."""
    all_of_it = None
    if duration is not None:
        start, end = (rrb.TimeRangeBoundary.absolute(seconds=t) for t in (0.0, duration))
        all_of_it = rrb.TimeAxis(view_range=rrb.TimeRange(start=start, end=end))
    return rrb.TimeSeriesView(
        name=name,
        origin=entity("plots", *what.split("/", 1)),
        axis_x=all_of_it,
        plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop, visible=legend),
    )


def _blueprint(main: Any, plots: list[Any], live: bool, timeline: str = TIMELINE, speed: float = 1.0) -> Any:
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
            play_state="following" if live else "playing",
        ),
        auto_views=False,
        auto_layout=False,
    )


def set_time(recording: Any, frame: int, t: float) -> None:
    """What is logged next belongs to a frame at t [s] of the scene."""
    recording.set_time("frame", sequence=frame)
    recording.set_time(TIMELINE, duration=t)


def entity(*parts: str) -> str:
    """A path in rerun, whatever characters the names have."""
    return "/" + str(rr.new_entity_path(list(parts))).lstrip("/")


def names(labels: list[str], widths: list[float] | None = None) -> Any:
    """Names and colours of a plot's curves; a curve named "total" is grey."""
    colours = [TOTAL if label == "total" else CURVES[i % len(CURVES)] for i, label in enumerate(labels)]
    return rr.SeriesLines(names=labels, colors=colours, widths=widths or [2.0] * len(labels))


def number(value: float | None) -> float:
    """What a message says as null is not finite; curves have a gap there."""
    return math.nan if value is None else value
