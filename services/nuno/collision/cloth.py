"""How cloth lies to cloth in published frames: where it passes through, and how near it comes."""

from __future__ import annotations

from typing import Any

import numpy as np

from nuno.collision.clearance import least_distance
from nuno.collision.crossings import find_crossings
from nuno.collision.pairs import Mesh, mesh_of, near_pairs
from nuno.scene.scene_file import Loaded
from nuno.wire.arrays import BadMessage, decode_arrays
from nuno.wrong import Wrong, check_array
from nuno_schemas.fabric import Float
from nuno_schemas.layout import Bounds
from nuno_schemas.messages import Header

MOST_PLACES = 100
"""Where cloth passes through cloth is told of so many edges at most."""


class ClothCheck:
    """The cloth of one run, where it meets cloth, and what was found of it so far."""

    def __init__(self, loaded: Loaded) -> None:
        assert loaded.cloth_contact is not None
        self.meet = loaded.scene.meet()
        self.thickness = float(getattr(loaded.cloth_contact.config, "thickness", 0.0))
        """Distances are looked for up to this [m]; 0 of contact that has none."""
        self.mesh: Mesh | None = None
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
            self.names = [str(piece["name"]) for piece in text["objects"]]
            self.mesh, self.piece = mesh_of(faces), np.repeat(np.arange(len(self.meet)), number)
        except (LookupError, TypeError, ValueError) as error:
            raise BadMessage(f"a fabric without {error}") from None
        except Wrong as error:
            raise BadMessage(f"a fabric of which {error}") from None

    def look(self, points: Float, header: Header) -> dict[str, Any]:
        """What a frame's report says of points (n, 3). Raises BadMessage for points of another cloth."""
        if self.mesh is None or not np.isfinite(points).all():
            return {}
        if len(points) != len(self.piece):
            raise BadMessage(f"{len(points)} points of a cloth of {len(self.piece)} vertices")
        self.looked += 1
        edge, face = near_pairs(points, self.mesh, self.thickness)
        one, other = self.piece[self.mesh.edges[edge, 0]], self.piece[self.mesh.faces[face, 0]]
        meeting = self.meet[one, other]
        pairs = edge[meeting], face[meeting]
        found = find_crossings(points, self.mesh, pairs)
        number = len(found.places)
        distance = 0.0 if number else least_distance(points, self.mesh, pairs, self.thickness)
        if distance is not None:
            self.least = distance if self.least is None else min(self.least, distance)
        places = found.places[:MOST_PLACES].tolist()
        objects = [
            (self.names[a], self.names[b])
            for a, b in self.piece[np.stack([found.edges[:, 0], found.triangles[:, 0]], axis=1)[:MOST_PLACES]].tolist()
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
        }
