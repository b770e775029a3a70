"""How cloth lies to cloth in published frames: where it passes through, and how near it comes; and where it passes
through bodies that it is not to.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from nuno.collision.bodies import Bodies
from nuno.collision.clearance import least_distance
from nuno.collision.crossings import find_crossings
from nuno.collision.pairs import Mesh, NearPairs, mesh_of
from nuno.collision.surfaces import NO_SURFACES, surface
from nuno.scene.scene_file import Loaded
from nuno.wire.arrays import BadMessage, decode_arrays
from nuno.wrong import Wrong, check_array
from nuno_schemas.bodies import Poses
from nuno_schemas.fabric import Float
from nuno_schemas.layout import Bounds
from nuno_schemas.messages import Header

MOST_PLACES = 100
"""Where cloth passes through cloth is told of so many edges at most."""


class ClothCheck:
    """The cloth of one run, where it meets cloth and bodies as it meets cloth, and what was found of it so far."""

    def __init__(self, loaded: Loaded, bodies: Bodies | None) -> None:
        assert loaded.cloth_contact is not None
        numbers = loaded.scene.met_bodies if bodies is not None else []
        self.bodies = [loaded.scene.bodies[i].name for i in numbers]
        """Names of the bodies."""
        each = [surface(bodies.geometry.of_bodies([i])) for i in numbers] if bodies is not None else []
        self.surface = surface(bodies.geometry.of_bodies(numbers)) if bodies is not None and numbers else NO_SURFACES
        self.solid = mesh_of(self.surface.faces)
        self.body = np.repeat(np.arange(len(each)), [len(one.vertices) for one in each])
        """(v,) number of the body that each of their vertices is of."""
        self.meet, self.objects = loaded.scene.meet(), [part.name for part in loaded.scene.objects]
        self.thickness = float(getattr(loaded.cloth_contact.config, "thickness", 0.0))
        """Distances are looked for up to this [m]; 0 of contact that has none."""
        self.near: NearPairs | None = None
        self.through: list[NearPairs] = []
        """Of cloth with cloth; and of its edges with bodies' triangles, and of theirs with its triangles, these
        bodies' vertices numbered behind the cloth's."""
        self.names: list[str] = []
        self.piece = np.zeros(0, np.int64)
        """(n,) number of the object that each vertex is of."""
        self.looked = self.crossed = self.most = 0
        """Frames that were looked at, those in which cloth passed through cloth, and the most crossings in one."""
        self.first: dict[str, Any] | None = None
        """Where it first did."""
        self.least: float | None = None
        """The least distance of all frames [m]."""

    def take(self, payload: bytes) -> None:
        """Look at another cloth from now on: the run's, or what an operation has made of it. Raises BadMessage."""
        arrays, text = decode_arrays(payload)
        try:
            faces = arrays["faces"]
            check_array("faces", faces, np.int32, (None, 3), Bounds(0, text["vertices"] - 1))
            number = [piece["stop"] - piece["start"] for piece in text["objects"]]
            self.names = [*(str(piece["name"]) for piece in text["objects"]), *self.bodies]
            mesh, n, none = mesh_of(faces), text["vertices"], np.zeros((0, 3), np.int64)
            self.near, self.piece = NearPairs(mesh, self.thickness), np.repeat(np.arange(len(self.meet)), number)
            both = Mesh(self.solid.faces + n, mesh.edges, none), Mesh(mesh.faces, self.solid.edges + n, none)
            self.through = [NearPairs(one, 0.0) for one in both]
        except (LookupError, TypeError, ValueError) as error:
            raise BadMessage(f"a fabric without {error}") from None
        except Wrong as error:
            raise BadMessage(f"a fabric of which {error}") from None

    def look(self, points: Float, header: Header, poses: Poses | None = None) -> dict[str, Any]:
        """What a frame's report says of points (n, 3), with bodies where they are then. Raises BadMessage for points of
        another cloth.
        """
        if self.near is None or not np.isfinite(points).all():
            return {}
        if len(points) != len(self.piece):
            raise BadMessage(f"{len(points)} points of a cloth of {len(self.piece)} vertices")
        self.looked += 1
        mesh, (edge, face) = self.near.mesh, self.near.at(points)
        one, other = self.piece[mesh.edges[edge, 0]], self.piece[mesh.faces[face, 0]]
        meeting = self.meet[one, other]
        pairs = edge[meeting], face[meeting]
        found = [find_crossings(points, mesh, pairs)]
        distance = 0.0 if len(found[0].places) else least_distance(points, mesh, pairs, self.thickness)
        if poses is not None and self.bodies:
            whole = np.concatenate([points, self.surface.at(poses)])
            found += [find_crossings(whole, near.mesh, near.at(whole)) for near in self.through]
        edges, triangles, crossed = (
            np.concatenate([getattr(one, name) for one in found]) for name in ("edges", "triangles", "places")
        )
        number, piece = len(crossed), np.concatenate([self.piece, len(self.meet) + self.body])
        if distance is not None:
            self.least = distance if self.least is None else min(self.least, distance)
        places = crossed[:MOST_PLACES].tolist()
        objects = [
            (self.names[a], self.names[b])
            for a, b in piece[np.stack([edges[:, 0], triangles[:, 0]], axis=1)[:MOST_PLACES]].tolist()
        ]
        if number:
            self.crossed, self.most = self.crossed + 1, max(self.most, number)
            self.first = self.first or {"frame": header.frame, "t": header.t, "place": places[0], "objects": objects[0]}
        return {"crossings": number, "places": places, "objects": objects, "distance": distance}

    def summary(self) -> dict[str, Any]:
        """What the report says of a run."""
        return {
            "looked": self.looked,
            "crossed": self.crossed,
            "crossings": self.most,
            "first_crossing": self.first,
            "least_distance": self.least,
            "thickness": self.thickness,
            "bodies": self.bodies,
            "allowed": [[self.objects[i], self.objects[j]] for i, j in np.argwhere(np.triu(~self.meet)).tolist()],
        }
