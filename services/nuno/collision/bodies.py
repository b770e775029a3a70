"""All bodies of a scene as one geometry, and their poses."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from nuno.scene.scene_file import Loaded
from nuno_schemas.bodies import Geometry, Poses
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Int
from nuno_schemas.live import Live
from nuno_schemas.plugin import BodyShape, Mover


@dataclass(frozen=True)
class Bodies:
    """All bodies of a scene: their geometry and their motions."""

    geometry: Geometry
    movers: tuple[Mover | None, ...]
    notes: tuple[str, ...] = ()
    """Notes about the bodies for the user."""

    def live(self) -> Iterator[tuple[str, tuple[str, ...], Live]]:
        """Yield name, joints and present pose of each live body."""
        for name, mover in zip(self.geometry.bodies, self.movers, strict=True):
            if mover is not None and mover.live is not None:
                yield name, mover.joints, mover.live

    def poses(self, t: float) -> Poses:
        """Return the poses of all frames at time t [s]."""
        parts = [m.pose(t) if m else (np.array([[1.0, 0, 0, 0]]), np.zeros((1, 3))) for m in self.movers]
        return Poses(t, np.concatenate([q for q, _ in parts]), np.concatenate([p for _, p in parts]))


def build_bodies(loaded: Loaded) -> Bodies:
    """Build a scene's bodies and join them. Raises BadInput."""
    shapes: list[BodyShape] = []
    movers: list[Mover | None] = []
    for i, (collider, motion) in enumerate(zip(loaded.colliders, loaded.motions, strict=True)):
        field = f"bodies[{i}].motion"
        try:
            mover = motion.plugin.prepare(motion.config, loaded.files) if motion else None
            field = f"bodies[{i}].collider"
            shape = collider.plugin.build(collider.config, mover, loaded.files)
        except BadInput as error:
            raise loaded.at(field, error) from None
        shapes.append(shape)
        movers.append(replace(mover, pose=shape.pose) if mover and shape.pose else mover)
    each = zip(loaded.scene.bodies, movers, shapes, strict=True)
    notes = [f"{body.name}: {n}" for body, mover, shape in each for n in (mover.notes if mover else ()) + shape.notes]
    return Bodies(_geometry(loaded, shapes), tuple(movers), tuple(notes))


def _geometry(loaded: Loaded, shapes: list[BodyShape]) -> Geometry:
    bodies = loaded.scene.bodies
    names = [f"{body.name}/{frame}" for body, shape in zip(bodies, shapes, strict=True) for frame in shape.frames]
    starts = np.cumsum([0, *(len(s.frames) for s in shapes)])
    of_triangles = [getattr(contact.plugin, "of_triangles", False) for contact in loaded.contacts]
    fields = [None if of else field for s, of in zip(shapes, of_triangles, strict=True) for field in s.fields]
    return Geometry(
        tuple(body.name for body in bodies),
        tuple(names),
        np.concatenate([s.kind for s in shapes]).astype(np.int8),
        np.concatenate([s.frame + at for s, at in zip(shapes, starts, strict=False)]).astype(np.int32),
        np.repeat(np.arange(len(shapes), dtype=np.int32), [len(s.kind) for s in shapes]),
        np.concatenate([s.a for s in shapes]),
        np.concatenate([s.b for s in shapes]),
        np.concatenate([s.radius for s in shapes]),
        np.array([np.nan if b.stiffness == "auto" else b.stiffness for b in bodies]),
        np.array([b.damping for b in bodies]),
        np.array([b.friction for b in bodies]),
        *_join_meshes(shapes),
        tuple(fields),
        tuple(skin for s in shapes for skin in s.skins),
    )


def _join_meshes(shapes: list[BodyShape]) -> tuple[Float, Int, Int]:
    """Return vertices, faces and owners of all bodies' meshes, in Geometry's layout."""
    vertices = np.cumsum([0, *(len(s.vertices) for s in shapes)])
    primitives = np.cumsum([0, *(len(s.kind) for s in shapes)])
    return (
        np.concatenate([s.vertices for s in shapes]),
        np.concatenate([s.faces + at for s, at in zip(shapes, vertices, strict=False)]).astype(np.int32),
        np.concatenate([s.owner + at for s, at in zip(shapes, primitives, strict=False)]).astype(np.int32),
    )
