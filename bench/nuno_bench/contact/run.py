"""One random scene, stepped to its end: in which frames cloth passes through cloth, by ipctk and by our own check."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from nuno.collision.crossings import find_crossings
from nuno.collision.pairs import mesh_of
from nuno.scene import scene_file
from nuno.simulation.run import Simulation
from nuno_bench.problem.random_scenes import CLOTHS, random_pile
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Int

Verdict = Literal["clean", "crossed", "disagrees", "failed", "refused", "crashed"]


@dataclass(frozen=True)
class Passed:
    """What came of a scene.

    fabrics, cloths  of its pieces: presets or `springs`; quads, triangles, irregular triangles or a skirt
    frames           that were stepped and looked at, the start left out
    crossed, own     numbers of those in which cloth passes through cloth, by ipctk and by the collision service's check
    vertex_steps     vertices times steps
    cut, held        of these, those that were cut short: of free vertices, and of held ones
    left_out         pairs that found no place in a list
    touching         most pairs that touched after a frame
    status, message  of the last frame, or why there was none
    """

    seed: int
    solver: str = ""
    body: str = ""
    fabrics: Sequence[str] = ()
    cloths: Sequence[str] = ()
    rate: float = 0.0
    vertices: int = 0
    frames: int = 0
    crossed: list[int] = field(default_factory=list)
    own: list[int] = field(default_factory=list)
    vertex_steps: int = 0
    cut: int = 0
    held: int = 0
    left_out: int = 0
    touching: int = 0
    status: str = "ok"
    message: str = ""
    seconds: float = 0.0

    @property
    def verdict(self) -> Verdict:
        if self.crossed or self.own:
            return "crossed" if self.crossed == self.own else "disagrees"
        if self.status in ("refused", "crashed"):
            return "refused" if self.status == "refused" else "crashed"
        return "clean" if self.status == "ok" else "failed"

    @property
    def share(self) -> float:
        """Of free vertices' steps, how many were cut short."""
        return self.cut / self.vertex_steps if self.vertex_steps else 0.0


def run_pile(task: tuple[int, float]) -> Passed:
    """The scene of a seed, for a duration [s]. What goes wrong, whatever it raises, is a finding about the scene."""
    (seed, duration), begun = task, time.perf_counter()
    with tempfile.TemporaryDirectory(prefix="nuno-") as folder:
        found = Passed(seed)
        try:
            path = random_pile(seed, duration, Path(folder))
            found = made_of(seed, scene_file.read(path).data)
            simulation = Simulation.with_bodies(scene_file.read(path), 1)
        except BadInput as error:
            return replace(found, status="refused", message=" ".join(str(error).split()))
        except Exception as error:
            return replace(found, status="crashed", message=f"{type(error).__name__}: {error}")
        found = watch(simulation, found)
    return replace(found, seconds=time.perf_counter() - begun)


def made_of(seed: int, scene: dict[str, Any]) -> Passed:
    """What a scene is made of, by its data."""
    models = [part["model"] for part in scene["objects"]]
    bodies = scene.get("bodies", [])
    worn = any("attach" in model for model in models)
    fabrics = {model["fabric"] if isinstance(model["fabric"], str) else "springs" for model in models}
    cloths = {model.get("cells", "skirt" if model["plugin"] == "skirt" else CLOTHS[-1]) for model in models}
    body = "wearer" if worn else bodies[0]["collider"]["plugin"] if bodies else "none"
    return Passed(seed, scene["solver"]["plugin"], body, tuple(sorted(fabrics)), tuple(sorted(cloths)),
                  scene["frame_rate"])  # fmt: skip


def watch(simulation: Simulation, found: Passed) -> Passed:
    """Step to the end, or to where it stops, and look at every frame that would be published."""
    faces, number = simulation.fabric.faces, simulation.fabric.number
    oracle, mesh = Oracle(simulation.state.x, faces), mesh_of(faces)
    crossed, own, steps, most, counts = list[int](), list[int](), 0, 0, dict[str, int]()
    frames, status, message = 0, "ok", ""
    while not simulation.finished and status == "ok":
        try:
            report = simulation.step().report
        except Exception as error:
            status, message = "crashed", f"{type(error).__name__}: {error}"
            break
        status, message, steps = report.status, report.message, steps + report.steps
        if status != "ok":
            break
        counts, most = dict(report.counts), max(most, report.counts["cloth_contacts"])
        frames, x = simulation.frame, simulation.state.x
        crossed += [frames] * oracle.crossed(x)
        own += [frames] * (len(find_crossings(x, mesh).edges) > 0)
    return replace(
        found, vertices=number, frames=frames, crossed=crossed, own=own,
        vertex_steps=number * steps, cut=counts.get("cut_short", 0), held=counts.get("held_cut_short", 0),
        left_out=counts.get("pairs_left_out", 0), touching=most, status=status, message=message,
    )  # fmt: skip


class Oracle:
    """Whether cloth passes through cloth, as ipc-toolkit sees it, by none of our own code.

    Of a mesh x (n, 3) [m] of triangles (f, 3); the last `body` vertices are a body's, which may pass through itself.
    """

    def __init__(self, x: Float, faces: Int, body: int = 0) -> None:
        import ipctk

        self._ipctk, self._mesh = ipctk, ipctk.CollisionMesh(x, mesh_of(faces).edges, faces)
        if body:
            self._mesh.can_collide = ipctk.make_static_obstacle_filter(len(x) - body)

    def crossed(self, x: Float) -> bool:
        """Whether an edge goes through a triangle that it shares no vertex with, of vertices at x (n, 3) [m]."""
        return bool(self._ipctk.has_intersections(self._mesh, x))
