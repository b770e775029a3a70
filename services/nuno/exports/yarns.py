"""Ray-traced pictures of knits: yarns as curves on skin, straight lines, the density of stitches."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel

from nuno.exports.camera import place_camera, read_view, z_up
from nuno.exports.cloth import body_vertices, check_size, read_bodies, read_frame, read_pieces
from nuno.exports.curves import apply, find_operation
from nuno.output_files import Progress, check_target, write_png
from nuno.plugin_contract import registry
from nuno.recording.reader import Recording, opened
from nuno.recording.recorded import Frame
from nuno.scene.chosen_plugins import Chosen
from nuno.scene.recorded_scene import restored_scene
from nuno.scene.scene_file import Loaded
from nuno.simulation.cloth import build_fabric
from nuno.simulation.yarns import find_pressure, has_pressure, structural_edges
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric
from nuno_schemas.operation import YarnCurves
from nuno_schemas.pictures import Camera, Mesh, SurfaceValues, Worn
from nuno_schemas.scene import View

GROUP = "nuno.yarn_pictures"
STYLE = "yarns"
"""The default style of a scene."""


def export_yarn_picture(
    source: Recording | Path | str,
    path: Path,
    style: str | None = None,
    frame: int | None = None,
    size: tuple[int, int] | None = None,
    overrides: tuple[str, ...] = (),
    progress: Progress | None = None,
) -> Path:
    """Draw one frame (default: the last) of a knit as PNG, in the given style, else the scene's, else `yarns`.

    `overrides` are key=value of the scene's `view`. Raises BadInput for a recording without yarns, an unknown style or
    field, a missing frame, and a knit that the style cannot draw.
    """
    check_target(path, ".png")
    with opened(source) as recording, styled(recording, style, overrides) as (loaded, chosen):
        shown = read_frame(recording, frame)
        worn = read_worn(recording, loaded, shown, chosen)
        camera = find_camera(loaded.scene.view, worn, size)
        name = recording.metadata.get("run", {}).get("scene") or str(recording.scene.get("name", ""))
        colours = [piece.colour for piece in read_pieces(recording) if piece.yarns is not None and piece.colour]
        config = captioned(chosen, name, shown.t, colours)
        return write_png(path, chosen.plugin.draw(config, worn, camera, progress))


@contextmanager
def styled(recording: Recording, style: str | None, overrides: tuple[str, ...]) -> Iterator[tuple[Loaded, Chosen]]:
    """Yield a recording's scene and its plugin for yarn pictures, while the scene's files exist. Raises BadInput."""
    for item in overrides:
        if not item.startswith("view."):
            problem, limit = "this field is no matter of pictures", "fields of `view`"
            raise BadInput(problem, field="--set", value=item, limit=limit, remedy="e.g. --set view.yarns.radius=0.1mm")
    if style is not None:
        try:
            registry.load(GROUP, style)
        except BadInput as error:
            raise BadInput(error.problem, field="--style", value=style, remedy=error.remedy) from None
    choice = read_view(recording).yarns
    named = choice.plugin if choice is not None else None
    chosen = style or named or STYLE
    start = () if chosen == named else (f"view.yarns={{plugin: {chosen}}}",)
    with restored_scene(recording, (*start, *overrides)) as loaded:
        if loaded.yarn_picture is None:
            raise BadInput("the scene says no style for its yarns", field="--style", remedy="give one")
        yield loaded, loaded.yarn_picture


def read_worn(recording: Recording, loaded: Loaded, frame: Frame, chosen: Chosen) -> Worn:
    """Return the knits and bodies of a frame, z up. Raises BadInput for a scene without yarns, or impossible curves."""
    pieces = read_pieces(recording)
    check_size(recording, pieces, frame)
    fabric, _ = build_fabric(loaded)
    if fabric.yarns is None:
        raise BadInput(
            "the recording has no yarns to draw", str(recording.path), field="--style", remedy="leave --style out"
        )
    shown = [Mesh(z_up(frame.x[p.start : p.stop]), p.faces) for p in pieces if len(p.faces)]
    bodies = read_bodies(recording)
    points = body_vertices(recording, bodies, frame.t)
    if bodies is not None and len(points):
        shown.insert(0, Mesh(z_up(points), bodies.faces, two_sided=False))
    return put_on(loaded, fabric, frame, chosen, shown)


def put_on(loaded: Loaded, fabric: Fabric, frame: Frame, chosen: Chosen, bodies: list[Mesh]) -> Worn:
    """Return a fabric of yarns on bodies and other cloth, z up. Raises BadInput if `chosen` cannot show it."""
    yarns = make_curves(loaded, fabric, frame, chosen.config) if chosen.plugin.curves else None
    edges = np.asarray(structural_edges(fabric)[0], np.int32)
    pressure = find_values(loaded, fabric, frame) if chosen.plugin.shows else None
    return Worn(tuple(bodies), z_up(np.asarray(frame.x, np.float64)), edges, yarns, pressure)


def find_values(loaded: Loaded, fabric: Fabric, frame: Frame) -> SurfaceValues:
    """Return the pressure at the points. Raises BadInput for a net of yarns that is not a knit."""
    if not has_pressure(fabric):
        raise BadInput("only a knit has pressure", field="--style", remedy="take yarns, lines or density")
    pressure = find_pressure(loaded, fabric, np.asarray(frame.x, np.float64)).arrays["pressure"]
    return SurfaceValues("points", np.asarray(pressure, np.float64), "pressure [Pa]")


def make_curves(loaded: Loaded, fabric: Fabric, frame: Frame, config: BaseModel) -> YarnCurves | None:
    """Return yarns as smooth curves, z up, with the radius of `config`, if it has one."""
    radius = getattr(config, "radius", None)
    operation, settings = find_operation("smooth", {} if radius is None else {"radius": radius})
    curves = apply(operation, settings, loaded, fabric, frame).curves
    if curves is None:
        return None
    return YarnCurves(z_up(curves.points), curves.ptr, curves.radius, curves.kind, curves.names, z_up(curves.normal))


def find_camera(view: View, worn: Worn, size: tuple[int, int] | None) -> Camera:
    """Return the camera of the scene's view, with omitted fields fitted to bodies and yarns."""
    points = Mesh(worn.points, np.zeros((0, 3), np.int32))
    return place_camera(view, [points] if view.close else [*worn.bodies, points], size or view.size)


def captioned(chosen: Chosen, name: str, t: float, colours: list[str]) -> BaseModel:
    """Return the style's settings with defaults for omitted ones: a caption of scene and time [s], and for yarns the
    first of their objects' colours.
    """
    config: Any = chosen.config
    update: dict[str, Any] = {}
    if config.caption is None:
        update["caption"] = f"{name}   t = {t:.2f} s"[:200]
    if colours and "colour" in type(config).model_fields and "colour" not in config.model_fields_set:
        update["colour"] = colours[0]
    result: BaseModel = config.model_copy(update=update)
    return result
