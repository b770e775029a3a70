"""Closed surfaces of colliders: from a file, or the figures and solids that come with nuno."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field, model_validator

from nuno_contact.colliders.shapes import ORIGIN
from nuno_contact.figures.leg import LANDMARKS, leg_mesh
from nuno_contact.figures.person import person_mesh
from nuno_contact.figures.solids import box_mesh, cone_mesh
from nuno_contact.figures.torso import GIRTHS, HEIGHTS, torso_mesh
from nuno_contact.quantities import Angle, Point, Reach, Size
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float, Int
from nuno_schemas.plugin import Config, Files

ARMS = (math.radians(40.0), math.radians(80.0))
"""range of angles in which a mannequin's arms are clear of its trunk, and end below its shoulders [rad]"""
RANGE = (0.7, 1.4)
"""range of a mannequin's girths, as shares of the average"""
PERSON = {name: height for name, height in (HEIGHTS | LANDMARKS).items() if name != "neck"}
"""heights of a person's girths [m]; that of the neck is behind the chin"""
MANNEQUINS, SOLIDS = ("torso", "person"), ("box", "cylinder", "cone")


class Girths(Config):
    """Girths of a mannequin [m]; by default the average."""

    bust: Size | None = Field(default=None, description="round the breasts, 90 cm unless given [m]")
    waist: Size | None = Field(default=None, description="at its narrowest, 69.8 cm unless given [m]")
    hip: Size | None = Field(default=None, description="at its widest, 95.7 cm unless given [m]")
    neck: Size | None = Field(default=None, description="of the stump, 33 cm unless given [m]")
    arm: Size | None = Field(default=None, description="over the biceps, 28.1 cm unless given [m]")


class Surface(Config):
    """A closed surface: a file's, else a built-in one, scaled, then moved by `centre`."""

    file: str | None = Field(default=None, description="a mesh beside the scene: OBJ, PLY, STL or GLB")
    shape: Literal["leg", "torso", "person", "box", "cylinder", "cone"] | None = Field(
        default=None,
        description="where no file is given, one that comes with nuno: an average leg; a torso with stumps of arms and "
        "neck; a whole mannequin; or a solid of this size",
    )
    size: tuple[Size, Size, Size] | None = Field(
        default=None, description="of a box, a cylinder or a cone: its width, height and depth [m]"
    )
    rounding: Reach = Field(default=0.0, description="of a solid: the radius of its edges [m]")
    top: float = Field(default=0.0, ge=0, le=1, description="of a cone: its top's width, of its base's")
    resolution: int = Field(default=96, ge=12, le=2048, description="of the shape: vertices round the leg or the waist")
    girths: Girths | None = Field(default=None, description="of a mannequin, where they are to be others")
    arms: Angle = Field(
        default=0.25 * math.pi, description="of a mannequin: between upper arms and the plumb line [rad]"
    )
    scale: Size = Field(default=1.0, description="length of one of the file's units [m]; 1 leaves a shape its size")
    up: Literal["y", "z"] = Field(default="y", description="which of the file's axes points up; z is turned to y")
    centre: Point = Field(
        default=ORIGIN,
        description="where the mesh's origin comes to lie, in the joint's frame, a skin's in the world [m]",
    )
    mend: bool = Field(default=False, description="turn triangles that face the wrong way and fill holes")

    @model_validator(mode="after")
    def _one_source(self) -> Surface:
        if self.file is None and self.shape is None:
            raise ValueError("a mesh needs a file or a shape")
        if self.up == "z" and self.file is None:
            raise ValueError("what comes with nuno has y up: up is for files")
        self._check_solid()
        given = {"girths", "arms"} & self.model_fields_set
        if given and self.shape not in MANNEQUINS:
            raise ValueError(f"only mannequins, torso and person, have {' and '.join(sorted(given))} to choose")
        if not ARMS[0] <= self.arms <= ARMS[1]:
            limits = " to ".join(f"{math.degrees(angle):g}" for angle in ARMS)
            raise ValueError(f"arms at {math.degrees(self.arms):g} deg: theirs may be raised by {limits} deg")
        return self

    def _check_solid(self) -> None:
        """Raise ValueError for an impossible solid, and for fields that only solids have."""
        given = {"size", "rounding", "top"} & self.model_fields_set
        if given and (self.shape not in SOLIDS or self.file is not None):
            raise ValueError(f"{' and '.join(sorted(given))} are for shape: {', '.join(SOLIDS)}; a file has its scale")
        if "top" in given and self.shape != "cone":
            raise ValueError(f"a {self.shape} is as wide above as below; a cone has a top")
        if self.shape not in SOLIDS or self.file is not None:
            return
        if self.size is None:
            raise ValueError(f"a {self.shape} needs its size; for example size: [40 cm, 75 cm, 40 cm]")
        most = 0.5 * min(self.size)
        if self.shape == "cone":
            # The circle that touches base and sides; half of it where the top is narrower.
            radius, height = 0.5 * self.size[0], self.size[1]
            along = radius * (1.0 - self.top)
            most = min(most, radius * height / (along + math.hypot(along, height)))
            most = min(most, self.top * radius) if self.top > 0.0 else most
        if self.rounding > 0.999 * most:
            raise ValueError(f"rounded by {self.rounding:g} m: at most {0.999 * most:.4g} m of this size")

    def heights(self) -> dict[str, float]:
        """Return the heights [m] of named places, of a built-in shape."""
        known = {"leg": LANDMARKS, "torso": HEIGHTS, "person": PERSON}
        return {} if self.file is not None or self.shape is None else known.get(self.shape, {})

    def upright(self, x: Float) -> Float:
        """Return points (n, 3) of the file with y up."""
        return x[:, [0, 2, 1]] * np.array([1.0, 1.0, -1.0]) if self.up == "z" else x

    def make(self, files: Files, read: Callable[[Path, float, bool], tuple[Float, Int]]) -> tuple[Float, Int]:
        """Return vertices (n, 3) [m] before they are moved, and triangles (f, 3); `read` reads a file's. Raises
        BadInput for a file that cannot be read, and a shape that cannot be made.
        """
        if self.file is not None:
            x, faces = read(files.resolve(self.file), self.scale, self.mend)
            return self.upright(x), faces
        if self.shape == "box" and self.size is not None:
            x, faces = box_mesh(self.size, self.rounding, self.resolution)
        elif self.shape in SOLIDS and self.size is not None:
            top = self.top if self.shape == "cone" else 1.0
            x, faces = cone_mesh(self.size, top, self.rounding, self.resolution)
        else:
            x, faces = leg_mesh(self.resolution) if self.shape == "leg" else make_mannequin(self)
        return x * self.scale, faces


def make_mannequin(config: Surface) -> tuple[Float, Int]:
    """Make the torso or the person of a configuration. Raises BadInput for girths so far from the average that its
    parts would meet.
    """
    given = {} if config.girths is None else config.girths.model_dump(exclude_none=True)
    for name, girth in given.items():
        low, high = (share * GIRTHS[name] for share in RANGE)
        if not low <= girth <= high:
            raise BadInput(
                "no mannequin is made with this girth", field=f"girths.{name}", value=f"{girth:g} m",
                limit=f"{low:.3g} to {high:.3g} m", remedy="scale the whole, or bring a mesh of your own",
            )  # fmt: skip
    make = {"torso": torso_mesh, "person": person_mesh}[config.shape or ""]
    return make(config.resolution, given, config.arms)
