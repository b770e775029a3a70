"""Yarns of knits: as files of curves, and in ray-traced pictures, of a recording or of a scene that runs."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from pydantic import BaseModel, ValidationError

from nuno.collision.bodies import build_bodies, surface
from nuno.exports.camera import place_camera, read_view, z_up
from nuno.exports.cloth import as_png, body_vertices, check_size, read_bodies, read_frame, read_pieces, shape_bodies
from nuno.output_files import Progress, check_target, write_png, writing
from nuno.plugin_contract import registry
from nuno.recording.reader import Recording, opened
from nuno.recording.recorded import Frame
from nuno.scene.chosen_plugins import Chosen
from nuno.scene.recorded_scene import restored_scene
from nuno.scene.scene_file import Loaded
from nuno.simulation import cloth
from nuno.simulation.cloth import build_fabric
from nuno.simulation.yarns import find_pressure, has_pressure, structural_edges
from nuno_schemas.bodies import OF_TRIANGLES
from nuno_schemas.colour import parse_hex
from nuno_schemas.dyeing import Form
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, State
from nuno_schemas.operation import Operation, Outcome, Surface, YarnCurves
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


def read_curves(recording: Recording, frame: Frame, overrides: tuple[str, ...] = ()) -> Mesh:
    """Return a knit's yarns as curves with the radius and the colours of the style `yarns`, z up. Raises BadInput."""
    with styled(recording, STYLE, overrides) as (loaded, chosen):
        fabric, pieces = build_fabric(loaded)
        yarns = make_curves(loaded, fabric, frame, chosen.config)
    if yarns is None:
        raise BadInput("the knit's yarns make no curves", str(recording.path), value=frame.number)
    config: Any = captioned(chosen, "", frame.t, [piece.colour for piece in pieces if piece.colour])
    table = np.stack([parse_hex(one) for one in ((config.colour,) if config.colour else config.colours)])
    colours = table[yarns.kind % len(table)][yarns.yarn()]
    return Mesh(yarns.points, np.zeros((0, 3), np.int32), colours, two_sided=False, yarns=yarns)


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


# Yarns of a recording as curves, for renderers and other programs.

OPERATIONS: dict[str, str] = {"straight": "repair", "smooth": "smooth"}
"""straight: the knit's links, repaired where they would cut through a body; smooth: loops as curves."""
KINDS = (".npz", ".obj")


def make_yarns(
    recording: Recording, frame: Frame, form: Form = "smooth", settings: dict[str, Any] | None = None
) -> Outcome:
    """Return the yarns of one frame of a recording; `settings` are those of the operation, by name.

    Raises BadInput for a recording without yarns, a frame of another scene or with infinite positions, and
    invalid settings.
    """
    operation, config = find_operation(form, settings or {})
    path = str(recording.path)
    if "edge_yarn" not in recording.fabric()[0]:
        remedy = "yarns are what the model knit makes"
        raise BadInput("the recording's cloth has no yarns", path, field="--yarns", remedy=remedy)
    with restored_scene(recording) as loaded:
        fabric = cloth.build_fabric(loaded)[0]
        if frame.x.shape != fabric.position.shape:
            raise BadInput(f"frame {frame.number} has {len(frame.x)} points, and the scene {fabric.number}", path)
        if not np.isfinite(frame.x).all():
            remedy = "name an earlier one with --frame"
            raise BadInput("the frame's positions are not finite", path, value=frame.number, remedy=remedy)
        made = apply(operation, config, loaded, fabric, frame)
    if made.curves is None:
        raise BadInput("the operation made no curves", value=OPERATIONS[form])
    return made


def apply(operation: Operation, config: BaseModel, loaded: Loaded, fabric: Fabric, frame: Frame) -> Outcome:
    """Apply an operation to a frame, with the mesh bodies at its time."""
    x = np.ascontiguousarray(frame.x, np.float64)
    return operation.apply(config, fabric, State(x, np.zeros_like(x), frame.t), _body_surface(loaded, frame.t))


def _body_surface(loaded: Loaded, t: float) -> Surface | None:
    """Return the surface of the mesh bodies at t [s], or None."""
    if not loaded.scene.bodies:
        return None
    bodies = build_bodies(loaded)
    meshes = np.flatnonzero(np.isin(bodies.geometry.kind, OF_TRIANGLES)).tolist()
    skin = surface(bodies.geometry.of_primitives(meshes))
    return Surface(skin.at(bodies.poses(t)), skin.faces) if meshes else None


def find_operation(form: Form, settings: dict[str, Any]) -> tuple[Operation, BaseModel]:
    """Return the operation that makes yarns of a form, and its configuration. Raises BadInput for invalid settings."""
    operation: Operation = registry.load("nuno.operations", OPERATIONS[form])
    try:
        return operation, operation.Config.model_validate(settings)
    except ValidationError as error:
        first = error.errors()[0]
        name = str(first["loc"][0]) if first["loc"] else ""
        problem = str(first["msg"]).removeprefix("Value error, ")
        if first["type"] == "extra_forbidden":
            problem = f"{form} yarns have no such setting"
        raise BadInput(problem, field=f"--{name}", value=settings.get(name)) from None


def export_yarns(
    source: Recording | Path | str,
    path: Path,
    frame: int | None = None,
    form: Form = "smooth",
    settings: dict[str, Any] | None = None,
) -> Outcome:
    """Write the yarns of one frame (default: the last) as curves, in the format of the name's ending.

    .npz holds the arrays of YarnCurves, the operation's own arrays per point, and frame and t [s]; .obj polylines [m],
    one object per kind of yarn. Returns the operation's outcome. Raises BadInput as make_yarns, and for other endings.
    """
    suffix = path.suffix.lower()
    if suffix not in KINDS:
        limit = ", ".join(KINDS)
        raise BadInput("no such kind of file of yarns", field="--yarns", value=path.name, limit=limit)
    check_target(path, suffix)
    with opened(source) as recording:
        shown = read_frame(recording, frame)
        made = make_yarns(recording, shown, form, settings)
    assert made.curves is not None
    with writing(path, suffix) as new, new.open("wb") as stream:
        if suffix == ".npz":
            fields = {name: np.asarray(values) for name, values in vars(made.curves).items()}
            np.savez(stream, allow_pickle=False, **fields, **made.arrays, frame=shown.number, t=shown.t)
        else:
            _write_obj(stream, made.curves, shown)
    return made


def _write_obj(stream: BinaryIO, curves: YarnCurves, frame: Frame) -> None:
    """Write polylines with enough digits to restore every float64; points count from 1."""
    stream.write(f"# nuno yarns of frame {frame.number} at {frame.t!r} s\n".encode())
    number = 0
    for kind, name in enumerate(curves.names):
        mine = np.flatnonzero(curves.kind == kind)
        if not len(mine):
            continue
        stream.write(f"# radius {float(curves.radius[mine].max())!r} m\no {name}\n".encode())
        for yarn in mine:
            points = curves.points[curves.ptr[yarn] : curves.ptr[yarn + 1]]
            lines = ["v {!r} {!r} {!r}".format(*row) for row in points.tolist()]
            lines.append("l " + " ".join(map(str, range(number + 1, number + 1 + len(points)))))
            stream.write(("\n".join(lines) + "\n").encode())
            number += len(points)


# Drawing of a scene's yarns without a recording, from the scene and its positions.

TRIAL = (16, 16)
"""Size in pixels of the trial picture, which shows errors before anything starts."""


class Artist:
    """Draws frames of one scene with one camera, which is fitted to the first frame.

    Raises BadInput for a scene without yarns, and for one that its style cannot draw.
    """

    def __init__(self, loaded: Loaded) -> None:
        self.loaded = loaded
        plain = registry.load(GROUP, STYLE)
        self.chosen = loaded.yarn_picture or Chosen(GROUP, plain, plain.Config(), "view.yarns", {})
        self.fabric, self.pieces = build_fabric(loaded)
        if self.fabric.yarns is None:
            problem, remedy = "the scene has no yarns to draw", "leave view.pictures out; yarns are what a knit has"
            raise loaded.at("view.pictures", BadInput(problem, remedy=remedy))
        self.bodies = build_bodies(loaded) if loaded.scene.bodies else None
        self.shapes = None
        if self.bodies is not None:
            self.shapes = shape_bodies(self.bodies.geometry, self.bodies.poses(0.0))
        self.camera: Camera | None = None
        start = Frame(0, 0.0, "", np.asarray(self.fabric.position))
        with loaded.errors_at("view"):
            worn = self.show(start)
            self._picture(worn, start, replace(find_camera(loaded.scene.view, worn, None), size=TRIAL))

    def draw(self, frame: Frame) -> bytes:
        """Return a frame's picture as PNG. Raises BadInput for a frame that cannot be drawn."""
        if not np.isfinite(frame.x).all():
            raise BadInput(f"the positions of frame {frame.number} are not finite")
        worn = self.show(frame)
        self.camera = self.camera or find_camera(self.loaded.scene.view, worn, None)
        return as_png(self._picture(worn, frame, self.camera), optimize=True)

    def show(self, frame: Frame) -> Worn:
        """Return yarns, bodies and other cloth of a frame."""
        meshes = []
        if self.bodies is not None and self.shapes is not None and len(self.shapes.vertices):
            at = self.shapes.at(self.bodies.poses(frame.t))
            meshes.append(Mesh(z_up(at), self.shapes.faces, two_sided=False))
        if len(self.fabric.faces):
            meshes.append(Mesh(z_up(frame.x), self.fabric.faces))
        return put_on(self.loaded, self.fabric, frame, self.chosen, meshes)

    def _picture(self, worn: Worn, frame: Frame, camera: Camera) -> np.ndarray:
        colours = [piece.colour for piece in self.pieces if piece.colour]
        config = captioned(self.chosen, self.loaded.scene.name, frame.t, colours)
        return np.asarray(self.chosen.plugin.draw(config, worn, camera))
