"""Lines drawn on cloth, ridges and valleys, and the smoothing of the cloth around them."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from nuno_schemas.parts import Metres, Part
from nuno_schemas.units import quantity

Number = Annotated[float, quantity("")]
Weight = Annotated[float, quantity("", ge=0, le=1)]

MOST_POINTS = 100_000
PLACES = ("points", "texture", "on_faces", "file")
"""Fields that give the position of a line."""
BARYCENTRIC = 1e-6
"""Largest difference of the sum of barycentric coordinates from 1."""


class OnFace(Part):
    """A point in a triangle of the cloth at the time when the line is drawn."""

    face: int = Field(ge=0, description="of the object's triangles, counted from 0")
    at: tuple[Weight, Weight, Weight] = Field(description="barycentric coordinates: shares of its corners")

    @model_validator(mode="after")
    def _whole(self) -> OnFace:
        if abs(sum(self.at) - 1.0) > BARYCENTRIC:
            problem = "barycentric coordinates add up to {total}, and must to 1; a corner is [1, 0, 0]"
            raise PydanticCustomError("not_whole", problem, {"total": f"{sum(self.at):g}", "inside": ("at",)})
        return self


class Line(Part):
    """A ridge or a valley: a polyline on the cloth, given in one of four ways."""

    points: tuple[tuple[Metres, Metres, Metres], ...] | None = Field(
        default=None, min_length=2, max_length=MOST_POINTS, description="places near the cloth as it lies then [m]"
    )
    texture: tuple[tuple[Number, Number], ...] | None = Field(
        default=None, min_length=2, max_length=MOST_POINTS, description="texture coordinates, u and v"
    )
    on_faces: tuple[OnFace, ...] | None = Field(
        default=None, min_length=2, max_length=MOST_POINTS, description="triangles and places in them"
    )
    file: str | None = Field(
        default=None, description="an OBJ file beside the scene: each of its elements l is a line, places in metres"
    )
    height: Metres = Field(description="k, how far new vertices are raised: above 0 a ridge, below a valley [m]")
    closed: bool = Field(default=False, description="whether it goes on from its last point to its first")

    @model_validator(mode="after")
    def _one_place(self) -> Line:
        names = [name for name in PLACES if getattr(self, name) is not None]
        if len(names) != 1:
            problem = "a line is given by one of points, texture, on_faces and file, not by {given}"
            inside = (names[1],) if names else ()
            raise PydanticCustomError("one_place", problem, {"given": " and ".join(names) or "none", "inside": inside})
        if self.height == 0.0:
            problem = "a height of 0 raises nothing; give one above 0 for a ridge, below for a valley"
            raise PydanticCustomError("no_height", problem, {"inside": ("height",)})
        return self


class Smoothing(Part):
    """Taubin's lambda|mu: passes of x += lambda L(x), x += mu L(x), L by uniform weights."""

    passes: int = Field(default=8, ge=0, le=1000, description="how often; 0 leaves the cloth pointed")
    shrink: Number = Field(default=0.5, gt=0, lt=1, description="lambda")
    inflate: Number = Field(default=-0.53, description="mu, below 0 and larger than lambda")
    hierarchical: bool = Field(
        default=False, description="new vertices are smoothed among themselves only, so that a ridge stays one"
    )

    @model_validator(mode="after")
    def _does_not_shrink(self) -> Smoothing:
        if self.inflate >= 0.0 or -self.inflate <= self.shrink or self.inflate <= -2.0:
            problem = "mu is {mu}, and must lie between -2 and -lambda = {low}, or smoothing shrinks the cloth"
            raise PydanticCustomError(
                "shrinks", problem, {"mu": f"{self.inflate:g}", "low": f"{-self.shrink:g}", "inside": ("inflate",)}
            )
        return self
