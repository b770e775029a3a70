"""From a loaded scene to what is simulated: one fabric, one set of bodies, one system."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from types import MappingProxyType
from typing import Any

import numpy as np

from nuno.cloth.join import join_fabrics
from nuno.cloth.start_checks import check_wearer, check_worn
from nuno.cloth.texture import check_texture
from nuno.collision.bodies import build_bodies
from nuno.collision.surfaces import surface, vertex_normals
from nuno.scene.chosen_plugins import Chosen
from nuno.scene.plausible import with_doubts
from nuno.scene.scene_file import Loaded
from nuno.stepping.stepper import require_memory
from nuno_schemas.bodies import OF_TRIANGLES, SKIN, Geometry, Poses, rotation_matrices
from nuno_schemas.errors import BadInput, nearest
from nuno_schemas.fabric import Binding, Fabric, Float, Int, State
from nuno_schemas.operation import Surface, arranges
from nuno_schemas.plugin import Rested
from nuno_schemas.scene import Fading, Scene
from nuno_schemas.system import Carried, System, Term
from nuno_schemas.vectors import turn

# An uneven start: what flat cloth needs to leave its plane.
#
# In a plane nothing pushes cloth out of it: without an unevenness a hung sheet keeps z = 0 for ever, and a strip stands
# on its edge whatever its length. Rejected: noise for each vertex, of which a finer mesh has more and steeper bumps, so
# that its springs would start strained; waves in space are the same unevenness on any mesh.

WAVES, SHORTEST = 64, 8.0
"""Waves that are added up, between the cloth's size (the diagonal of its bounding box) and so small a part of it."""


def roughen(fabric: Fabric, height: float, seed: int) -> Fabric:
    """The fabric with its free vertices moved along their normals by `height` [m], root mean square.

    Springs and hinges stay as they are: at rest the cloth is as flat as it was. Raises BadInput where it has no faces.
    """
    if len(fabric.faces) == 0:
        raise BadInput("only cloth with triangles has a normal to be rough along", remedy="leave it out")
    moved = height * _waves(fabric.position, np.random.default_rng(seed))
    held = fabric.pinned.copy()
    for binding in fabric.bindings:
        held[binding.vertices] = True
    moved[held] = 0.0
    return replace(fabric, position=fabric.position + moved[:, None] * vertex_normals(fabric.position, fabric.faces))


def _waves(x: Float, random: np.random.Generator) -> Float:
    """(n,) a sum of waves at places (n, 3), of mean square 1; numbers are added in an order that never changes."""
    size = math.hypot(*np.ptp(x, axis=0).tolist()) or 1.0
    total = np.zeros(len(x))
    for _ in range(WAVES):
        number = 2.0 * math.pi / size * SHORTEST ** random.uniform()
        up, turn, phase = random.uniform(-1.0, 1.0), *random.uniform(0.0, 2.0 * math.pi, 2)
        level = math.sqrt(1.0 - up**2)
        along = level * math.cos(turn) * x[:, 0] + up * x[:, 1] + level * math.sin(turn) * x[:, 2]
        total += np.cos(number * along + phase)
    return math.sqrt(2.0 / WAVES) * total


# Operations that move all cloth of a scene before anything acts on it.


@dataclass(frozen=True)
class Start:
    """The fabric of each object at the start, and what operations said that moved it there: operation, object ("" for
    all) and facts.
    """

    fabrics: list[Fabric]
    told: list[dict[str, Any]]


def arrange(loaded: Loaded, fabrics: list[Fabric], bodies: Surface | None) -> Start:
    """Let the scene's operations that arrange the start do so, in their order, round the bodies that cloth meets as it
    meets cloth. Raises BadInput.

    An operation on one object moves that one alone: all others are held.
    """
    scene, told = loaded.scene, list[dict[str, Any]]()
    stops = np.cumsum([0, *(fabric.number for fabric in fabrics)]).tolist()
    names = [spec.name for spec in scene.objects]
    objects = {name: np.arange(a, b, dtype=np.int32) for name, (a, b) in zip(names, pairwise(stops), strict=True)}
    meet = scene.meet() if scene.meets else np.ones((len(names), len(names)), np.bool_)
    thickness = getattr(loaded.cloth_contact.config, "thickness", None) if loaded.cloth_contact else None
    for i, (applied, chosen) in enumerate(zip(scene.operations, loaded.operations, strict=True)):
        if not arranges(chosen.plugin):
            continue
        whole = join_fabrics(fabrics, scene.name)
        if applied.object is not None:
            held = np.ones(whole.number, np.bool_)
            held[objects[applied.object]] = False
            whole = replace(whole, pinned=whole.pinned | held)
        try:
            made = chosen.plugin.arrange(chosen.config, whole, objects, meet, thickness, bodies)
        except BadInput as error:
            raise loaded.at(f"operations[{i}]", error) from None
        fabrics = [replace(f, position=made.position[a:b]) for f, (a, b) in zip(fabrics, pairwise(stops), strict=True)]
        told.append({"operation": chosen.name, "object": applied.object or "", "facts": dict(made.facts)})
    return Start(fabrics, told)


BYTES_PER_VERTEX = 400
"""What a run of cloth takes at most per vertex whose springs and hinges are runs along rows, as on
grids; `nuno bench speed` measures it. Models that keep every element apart know what they take."""


@dataclass(frozen=True)
class Piece:
    """Where one object's vertices lie in the joined fabric."""

    name: str
    start: int
    stop: int
    texture: str | None = None
    colour: str | None = None


def estimate_memory(loaded: Loaded) -> tuple[int, int]:
    """Vertices the scene will have, and what a run of them takes at most [bytes]. Raises BadInput.

    A model whose memory does not follow from its vertices has a method
    `memory(config, files, vertices)`, in bytes.
    """
    total, size = 0, 0
    for i, model in enumerate(loaded.models):
        try:
            vertices = model.plugin.count(model.config, loaded.files)
            known = getattr(model.plugin, "memory", None)
            size += known(model.config, loaded.files, vertices) if known else vertices * BYTES_PER_VERTEX
        except BadInput as error:
            raise with_doubts(loaded, f"objects[{i}].model", error) from None
        total += vertices
    return total, size


def check_memory(loaded: Loaded) -> None:
    """Raises BadInput, before anything is allocated, if the scene cannot fit in memory."""
    vertices, size = estimate_memory(loaded)
    require_memory(loaded, "objects", vertices, "vertices", size, "lower the resolution, or take springs away")


def build_fabric(
    loaded: Loaded, geometry: Geometry | None = None, poses: Poses | None = None
) -> tuple[Fabric, list[Piece]]:
    """All objects as one fabric, and where each lies; see `build_fabrics`. Raises BadInput."""
    return build_told(loaded, geometry, poses)[:2]


def build_told(
    loaded: Loaded, geometry: Geometry | None, poses: Poses | None, rested: Sequence[Rested] = ()
) -> tuple[Fabric, list[Piece], list[dict[str, Any]]]:
    """The same, and what operations said that have arranged it: see `nuno.cloth.build.Start`. Raises BadInput."""
    start = build_start(loaded, geometry, poses, rested)
    return join_fabrics(start.fabrics, loaded.scene.name), place_pieces(loaded, start.fabrics), start.told


def place_pieces(loaded: Loaded, fabrics: list[Fabric]) -> list[Piece]:
    """Where each object lies in the fabric of all."""
    stops = np.cumsum([fabric.number for fabric in fabrics]).tolist()
    each = zip(loaded.scene.objects, fabrics, stops, strict=True)
    return [Piece(spec.name, stop - f.number, stop, f.texture, spec.colour) for spec, f, stop in each]


def build_fabrics(
    loaded: Loaded, geometry: Geometry | None = None, poses: Poses | None = None, rested: Sequence[Rested] = ()
) -> list[Fabric]:
    """The fabric of each object where the scene starts, see `build_start`. Raises BadInput."""
    return build_start(loaded, geometry, poses, rested).fabrics


def build_start(
    loaded: Loaded, geometry: Geometry | None = None, poses: Poses | None = None, rested: Sequence[Rested] = ()
) -> Start:
    """The fabric of each object, and what operations said that have moved them from where models put them.

    Bodies, with their poses at the start, are built for objects drawn over one, unless they are given; all of them lie
    where they have `rested`, if they have. Raises BadInput.
    """
    arranging = loaded.scene.met_bodies and any(arranges(one.plugin) for one in loaded.operations)
    if geometry is None and loaded.colliders and (arranging or any(map(drawn_over, loaded.models))):
        bodies = build_bodies(loaded)
        geometry, poses = bodies.geometry, bodies.poses(0.0)
    fabrics = _build_models(loaded, geometry, poses, rested)
    if not arranging or geometry is None or poses is None:
        return arrange(loaded, fabrics, None)
    met = surface(geometry.of_bodies(loaded.scene.met_bodies))
    return arrange(loaded, fabrics, Surface(met.at(poses), met.faces))


def _build_models(
    loaded: Loaded, geometry: Geometry | None, poses: Poses | None, rested: Sequence[Rested]
) -> list[Fabric]:
    check_memory(loaded)
    over = [drawn_over(model) for model in loaded.models]
    fabrics: list[Fabric] = []
    for i, (model, spec) in enumerate(zip(loaded.models, loaded.scene.objects, strict=True)):
        try:
            given: tuple[Any, ...] = (model.config, loaded.files, loaded.scene.seed + i)
            if (name := over[i]) is None:
                fabric = model.plugin.build(*given)
            else:
                worn = [one for one, body in zip(fabrics, over, strict=False) if body == name and len(one.faces)]
                lain = {"rested": rested[i]} if rested and hasattr(model.plugin, "coarser") else {}
                x, faces = mesh_of(name, geometry, poses)
                check_wearer(loaded, name, x)
                fabric = model.plugin.build_over(*given, x, faces, worn, **lain)
            if loaded.scene.dye is not None and loaded.scene.dye.object == spec.name:
                check_texture(fabric, spec.name)
        except BadInput as error:
            raise with_doubts(loaded, f"objects[{i}].model", error) from None
        if spec.roughness and not rested:
            try:
                fabric = roughen(fabric, spec.roughness, loaded.scene.seed + i)
            except BadInput as error:
                raise loaded.at(f"objects[{i}].roughness", error) from None
        if rested and not hasattr(model.plugin, "coarser"):
            fabric = replace(fabric, position=rested[i].x)
        fabrics.append(fabric)
    return fabrics


def drawn_over(model: Chosen) -> str | None:
    """Name of the body that a model is drawn over, None for one that is built by itself."""
    over = getattr(model.plugin, "over", None)
    return over(model.config) if over else None


def no_body(name: str, known: Sequence[str]) -> BadInput:
    """That cloth is to be drawn over a body that a scene has not."""
    remedy = nearest(name, known)
    return BadInput("there is no such body to draw it over", field="over.body", value=name, remedy=remedy)


def mesh_of(name: str, geometry: Geometry | None, poses: Poses | None) -> tuple[Float, Int]:
    """Vertices (v, 3) [m] in the world and faces (f, 3) of a body that is one mesh. Raises BadInput."""
    if geometry is None or poses is None or name not in geometry.bodies:
        raise no_body(name, geometry.bodies if geometry else ())
    own = np.flatnonzero(geometry.body == geometry.bodies.index(name))
    if len(own) != 1 or geometry.kind[own[0]] not in OF_TRIANGLES:
        remedy = "give the body collider: {plugin: mesh, ...}"
        raise BadInput("only a mesh can be drawn over", field="over.body", value=name, remedy=remedy)
    return geometry.placed(int(own[0]), poses)


def bind(
    loaded: Loaded, fabric: Fabric, pieces: list[Piece], geometry: Geometry | None, poses: Poses | None
) -> list[Carried]:
    """Bound vertices, and where they are in the frames that carry them along.

    Local coordinates are those of the start, so cloth is put on where the scene places it; but for what is attached
    later. Raises BadInput for a body or frame that does not exist, or that the cloth is far from.
    """
    carried = []
    for binding in fabric.bindings:
        x = fabric.position[binding.vertices]
        try:
            skinned = skin_of(binding, geometry)
            index, local = frame_of(binding, geometry.frames if geometry else (), skinned), binding.local
            assert geometry is not None and poses is not None
            if local is None:
                check_worn(x, geometry, poses, index)
        except BadInput as error:
            vertex = int(binding.vertices[0])
            piece = next(i for i, piece in enumerate(pieces) if vertex < piece.stop)
            raise loaded.at(f"objects[{piece}].model.attach", error) from None
        skin = None
        if local is None and skinned is not None:
            known = geometry.skin(skinned)
            assert known is not None
            skin = known.beside(x, *geometry.placed(skinned, poses))
            own = slice(index, index + len(skin.place))
            local = skin.unbend(x, poses.rotation[own], poses.translation[own])
        elif local is None:
            inverse = rotation_matrices(poses.rotation[index]).T
            local = turn(inverse, x - poses.translation[index])
        carried.append(Carried(binding.vertices, local, np.full(len(local), index, np.int32), skin))
    return carried


def skin_of(binding: Binding, geometry: Geometry | None) -> int | None:
    """The primitive whose skin carries bound vertices: that of their body, where no frame of it is named."""
    if binding.frame is not None or geometry is None or binding.body not in geometry.bodies:
        return None
    own = (geometry.kind == SKIN) & (geometry.body == geometry.bodies.index(binding.body))
    return int(np.argmax(own)) if own.any() else None


def frame_of(binding: Binding, frames: Sequence[str], skinned: int | None = None) -> int:
    """Which of the frames, each BODY/FRAME, carries bound vertices; the first of a body whose skin does, a primitive by
    number. Raises BadInput for one that is not there, and for none that is named of a body that has several.
    """
    own = [name for name in frames if name.startswith(f"{binding.body}/")]
    if binding.frame is None and len(own) > 1 and skinned is None:
        problem = "the body has several frames, and cloth moves with one"
        names = ", ".join(name.removeprefix(f"{binding.body}/") for name in own)
        raise BadInput(problem, value=binding.body, limit=names, remedy="name it: attach: {body: ..., frame: ...}")
    name = own[0] if binding.frame is None and own else "/".join(filter(None, (binding.body, binding.frame)))
    if name not in frames:
        remedy = nearest(name, frames)
        raise BadInput("cloth is attached to a frame that no body has", value=name, remedy=remedy)
    return frames.index(name)


def build_system(
    loaded: Loaded, fabric: Fabric, pieces: list[Piece], geometry: Geometry | None, poses: Poses | None, threads: int
) -> System:
    """The fabric and everything that acts on it; poses are those of t = 0. Raises BadInput."""
    gravity = np.array(loaded.scene.gravity)
    carried = tuple(bind(loaded, fabric, pieces, geometry, poses))
    if not carried and may_attach(loaded):  # steps are compiled for what may be carried
        none = np.zeros(0, np.int32)
        carried = (Carried(none, np.zeros((0, 3)), none),)
    terms = []
    for i, force in enumerate(loaded.forces):
        terms.append(_prepared(loaded, f"forces[{i}]", force, fabric, loaded.scene.seed + 1000 + i))
    fields = {body.name: of.field for body, of in zip(loaded.scene.bodies, loaded.contacts, strict=True)}
    for contact, numbers in group_contacts(loaded):
        if geometry is not None and len((own := geometry.of_bodies(numbers)).kind):
            term = _prepared(loaded, contact.field, contact, fabric, own, gravity, fields=fields)
            terms.append(replace(term, bodies=own.bodies))
    met = loaded.scene.met_bodies
    if (meeting := loaded.cloth_contact) is not None:
        if not len(fabric.faces):
            problem = "only cloth of triangles meets cloth, and bodies as it meets cloth: here is none"
            raise loaded.at("cloth_contact", BadInput(problem, remedy="leave cloth_contact out"))
        objects = {piece.name: np.arange(piece.start, piece.stop, dtype=np.int32) for piece in pieces}
        bodies = [] if geometry is None or not met else [geometry.of_bodies(met), poses]
        term = _prepared(loaded, meeting.field, meeting, fabric, objects, loaded.scene.meet(), gravity, *bodies)
        terms.append(replace(term, bodies=tuple(loaded.scene.bodies[i].name for i in met)))
    return System(fabric, gravity, _most_damping(loaded.scene), tuple(terms), threads, carried)


def may_attach(loaded: Loaded) -> bool:
    """Whether the scene says that something is attached to a body while it goes on."""
    return any(hasattr(one.plugin, "apply_beside") for one in loaded.operations)


def group_contacts(loaded: Loaded) -> list[tuple[Chosen, list[int]]]:
    """The contacts of a scene, each with the numbers of the bodies that it is with: alike ones are one. Bodies that
    cloth meets as it meets cloth are in none.
    """
    groups: list[tuple[Chosen, list[int]]] = []
    for i, contact in enumerate(loaded.contacts):
        if i in loaded.scene.met_bodies:
            continue
        alike = (own for one, own in groups if (one.name, one.config) == (contact.name, contact.config))
        if (own := next(alike, None)) is None:
            groups.append((contact, own := []))
        own.append(i)
    return groups


def _most_damping(scene: Scene) -> float:
    """The largest damping [1/s] that there is in a run."""
    if isinstance(scene.damping, Fading):
        return max(scene.damping.first, scene.damping.last)
    return 3.0 * scene.frame_rate if scene.damping == "auto" else scene.damping


def _prepared(
    loaded: Loaded, field: str, chosen: Chosen, *args: object, fields: Mapping[str, str] = MappingProxyType({})
) -> Term:
    """A plugin's term; an error is about `field`, or the one of `fields` that it names the body of."""
    try:
        term: Term = chosen.plugin.prepare(chosen.config, *args)
    except BadInput as error:
        raise loaded.at(fields.get(error.field or "", field), error) from None
    return term


def start_state(fabric: Fabric) -> State:
    """The state at the start; pinned vertices stand still, whatever velocity the cloth has."""
    velocity = np.array(fabric.velocity, np.float64, order="C")
    velocity[fabric.pinned] = 0.0
    return State(np.array(fabric.position, np.float64, order="C"), velocity, 0.0)
