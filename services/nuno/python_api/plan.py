"""The plan of a run: services, features left out and why, stable step, and its estimated time."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nuno.bus.encodings import encode_arrays
from nuno.collision.bodies import find_sizes
from nuno.collision.messages import encode_geometry, encode_poses
from nuno.python_api.scene import Scene, as_texts, in_python, loaded
from nuno.report.run_report import describe_start
from nuno.resimulation.verification import steppers
from nuno.runtime.launch import make_plan
from nuno.runtime.service import Options
from nuno.runtime.stepper import MESSAGE
from nuno.scene import scene_file
from nuno.scene.scene_file import Loaded
from nuno.scene.warnings import scene_warnings
from nuno.simulation import cloth
from nuno.simulation.cloth import texture_size
from nuno.simulation.solver_selection.cloth import decide
from nuno.simulation.solver_selection.trials import Budget
from nuno.simulation.start_checks import start_warnings
from nuno_schemas.bodies import Geometry, Poses

if TYPE_CHECKING:
    from nuno.simulation.run import Simulation

Row = tuple[str, str]
REPORT = 220
"""Bytes of a message of `collision/report`."""


class Plan(list[Row]):
    """Rows of headings and texts; `str` formats them as `nuno plan` does."""

    def __str__(self) -> str:
        return "\n".join(map(line_of, self))

    def __repr__(self) -> str:
        return str(self)


def plan(
    scene: str | os.PathLike[str] | Mapping[str, Any] | Scene,
    *overrides: str | Mapping[str, Any],
    roots: Sequence[str | os.PathLike[str]] = (),
    **fields: Any,
) -> Plan:
    """Return the plan of a scene's run, and its cost; the arguments are those of `run`. Raises BadInput."""
    with in_python(), loaded(scene, as_texts([*overrides, fields]), roots) as scene_loaded:
        return Plan(describe(scene_loaded))


def line_of(row: Row) -> str:
    return f"{row[0]:9} {row[1]}"


def describe(loaded: Loaded, budget: Budget | None = None) -> Iterator[Row]:
    """Yield the rows of a plan, each as soon as it is known. Raises BadInput for a scene that would not start."""
    yield "scene", ": ".join(filter(None, (loaded.scene.name, loaded.scene.description)))
    # Warnings come before the work that they warn of, which may take long, or fail.
    yield from (("WARNING", text) for text in scene_warnings(loaded))
    loaded = decide(loaded, budget)
    services = make_plan(loaded, Options(record=Path("recordings")))
    rows = [("services", ", ".join(services.services))]
    if loaded.scene.moves:
        rows += _cloth(loaded)
    if loaded.scene.view.pictures is not None:
        from nuno.exports.yarns import Artist

        Artist(loaded)  # refuses bad pictures, as with an eye inside a body
    if loaded.dye is not None:
        from nuno.dye.run import describe_dye

        rows += describe_dye(loaded)
    yield from rows
    yield from (("left out" if i == 0 else "", text) for i, text in enumerate(services.left_out))


def _cloth(loaded: Loaded) -> list[tuple[str, str]]:
    from nuno.simulation.run import Simulation  # a dyeing without motion needs none

    simulation = Simulation.with_bodies(loaded)
    rows = _size(simulation) + _contacts(loaded)
    rows += [(operation["operation"], describe_start(operation["facts"])) for operation in simulation.arranged]
    if simulation.geometry is not None and simulation.poses is not None:
        rows += _attachments(simulation, simulation.geometry, simulation.poses)
        for name, sides in find_sizes(simulation.geometry, simulation.poses).items():
            rows.append(("bodies", "{}: {:.3g} x {:.3g} x {:.3g} m (x, y, z) at the start".format(name, *sides)))
    doubts = cloth.size_warnings(loaded, simulation.pieces, simulation.state.x)
    doubts += start_warnings(simulation.fabric, simulation.state.x, simulation.geometry, simulation.poses)
    rows += [("bodies", note) for note in simulation.body_notes] + [("WARNING", text) for text in doubts]
    rows += _texture(simulation)
    seconds = simulation.time_frame()  # this moves the cloth
    solver, limit = simulation.describe_step(loaded.integrator.name, simulation.limit.dt), simulation.limit.resolved
    rows.append(("solver", solver + (f", {limit * 1e3:.4g} ms at most by auto" if limit < math.inf else "")))
    rows += [("chosen", loaded.why)] if loaded.why else []
    return rows + simulation.describe_cost(seconds, _recorded_size(simulation), cloth.estimate_memory(loaded)[1])


def _recorded_size(simulation: Simulation) -> int:
    """Return the expected size of a recording's messages [bytes], with contact forces as of the present frame."""
    from nuno.simulation.service import describe_fabric, feel

    loaded, geometry, poses = simulation.loaded, simulation.geometry, simulation.poses
    once, each = [encode_arrays(*describe_fabric(simulation))], [simulation.encode()]
    if geometry is not None and poses is not None:
        once.append(encode_geometry(geometry))
        each += [encode_poses(poses, simulation.frame), bytes(REPORT)]
        if loaded.scene.record.contact_forces:
            contact, touches = feel(simulation)
            each += [contact.model_dump_json().encode(), encode_arrays(touches, {"bodies": list(geometry.bodies)})]
    kept = simulation.checkpoints * sum(array.nbytes for array in simulation.whole()[0].values())
    return kept + sum(map(len, once)) + loaded.scene.frames * sum(len(payload) + MESSAGE for payload in each)


def _texture(simulation: Simulation) -> list[tuple[str, str]]:
    """Return the size of the dyed object's texture, and of the dye cells on it."""
    dyed = simulation.loaded.dye
    if dyed is None:
        return []
    names = [piece.name for piece in simulation.pieces]
    width, height = texture_size(simulation.parts()[names.index(str(dyed.said.object))])
    text = f"{width:.3g} m x {height:.3g} m on {dyed.said.object}"
    cells = getattr(dyed.cloth.config, "cells", None)
    if cells is not None:
        size = width / cells[0]
        text += f": cell_size {1e3 * size:.3g} mm and cells [{cells[0]}, {max(1, round(height / size))}] are its own"
    return [("texture", text)]


def _contacts(loaded: Loaded) -> list[tuple[str, str]]:
    """Return which objects collide, and by which contact."""
    bodies = [body.name for body in loaded.scene.bodies]
    met = [f"{one.name} with {', '.join(bodies[i] for i in own)}" for one, own in cloth.group_contacts(loaded)]
    if loaded.cloth_contact is not None:
        bodies_met = [bodies[i] for i in loaded.scene.met_bodies]
        met.append(f"{loaded.cloth_contact.name} of cloth with {', '.join(['cloth', *bodies_met])}")
    return [("contact", "; ".join(met))] if met else []


def _size(simulation: Simulation) -> list[tuple[str, str]]:
    fabric = simulation.fabric
    parts = {
        "springs": fabric.springs, "triangles of a membrane": fabric.membrane, "hinges": fabric.hinges,
        "yarns": fabric.yarns,
    }  # fmt: skip
    counts = [f"{part.number:,} {name}" for name, part in parts.items() if part is not None]
    terms = [name for name, part in parts.items() if part is not None]
    terms += [
        *(["attachments"] if simulation.system.carried else []),
        *sorted({t.name for t in simulation.system.terms}),
    ]
    return [
        ("fabric", ", ".join([f"{fabric.number:,} vertices", *counts])),
        ("terms", ", ".join(terms) or "gravity and inertia only"),
    ]


def _attachments(simulation: Simulation, geometry: Geometry, poses: Poses) -> list[tuple[str, str]]:
    """Return the start positions of the frames that cloth is attached to."""
    rows = []
    for binding in simulation.fabric.bindings:
        if (skinned := cloth.skin_of(binding, geometry)) is not None:
            rows.append(("attached", f"to the skin of {binding.body}, each vertex to its place on it"))
            continue
        frame = cloth.frame_of(binding, geometry.frames, skinned)
        place = ", ".join(f"{v:.3g}" for v in poses.translation[frame])
        rows.append(("attached", f"to {geometry.frames[frame]}, which starts at [{place}] m"))
    return list(dict.fromkeys(rows))


# Estimate of a run's time: from frames that are stepped for it, then from the parts that are done.


@dataclass
class RuntimeEstimate:
    """Estimate of the remaining time of several pieces of work.

    expected  wall time of each by a prior estimate [s], by name; once one is done, only their ratios matter, since the
              others are assumed to be slower or faster by the same factor
    """

    expected: dict[str, float]
    taken: dict[str, float] = field(default_factory=dict)
    """Wall time of finished pieces [s]."""

    @property
    def left(self) -> float:
        """Remaining wall time [s]."""
        done = sum(self.expected[name] for name in self.taken)
        ratio = sum(self.taken.values()) / done if done > 0.0 else 1.0
        return ratio * sum(seconds for name, seconds in self.expected.items() if name not in self.taken)


def run_seconds(loaded: Loaded) -> float:
    """Estimate the wall time of a scene's steps [s] from a frame. Raises BadInput for a scene that cannot start."""
    loaded = decide(loaded)
    return loaded.scene.frames * frame_seconds(loaded)


def frame_seconds(loaded: Loaded) -> float:
    """Return the wall time of a frame's steps [s], of a scene without open choices."""
    return sum(make().time_frame() for make in steppers(loaded).values())


def keep_up(loaded: Loaded, budget: Budget | None = None) -> Loaded:
    """Decide a scene for a run whose frames wait for the clock: with an open accuracy, and frames that are slower than
    real time, it is `preview`, if that is faster. Raises BadInput as `decide`.
    """
    budget = budget or Budget()
    decided = decide(loaded, budget)
    if not loaded.scene.step_undecided or loaded.scene.accuracy is not None:
        return decided
    lasts, takes = 1.0 / loaded.scene.frame_rate, frame_seconds(decided)
    if takes <= lasts:
        return decided
    open_ = scene_file.load(loaded.data | {"accuracy": "preview"}, loaded.lines, loaded.file, loaded.files)
    coarser = decide(replace(open_, path=loaded.path, overrides=(*loaded.overrides, "accuracy=preview")), budget)
    if not (less := frame_seconds(coarser)) < takes:
        return decided
    clock = (
        f"for the clock, at normal a frame of {1e3 * lasts:.3g} ms takes {1e3 * takes:.3g} ms, here {1e3 * less:.3g}"
    )
    return replace(coarser, why=f"{coarser.why}; {clock}")
