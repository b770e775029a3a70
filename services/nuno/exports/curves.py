"""Yarns of a recording as curves, for renderers and other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from pydantic import BaseModel, ValidationError

from nuno.collision.bodies import build_bodies, surface
from nuno.exports.cloth import read_frame
from nuno.output_files import check_target, writing
from nuno.plugin_contract import registry
from nuno.recording.reader import Recording, opened
from nuno.recording.recorded import Frame
from nuno.scene.recorded_scene import restored_scene
from nuno.scene.scene_file import Loaded
from nuno.simulation import cloth
from nuno_schemas.bodies import OF_TRIANGLES
from nuno_schemas.dyeing import Form
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, State
from nuno_schemas.operation import Operation, Outcome, Surface, YarnCurves

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
