"""The configuration of a skirt, and checks that it can be made."""

from __future__ import annotations

import numpy as np
from pydantic import Field, field_validator, model_validator

from nuno_cloth.fabrics.material import FABRIC, FabricChoice
from nuno_cloth.models.placement import STILL, TEXTURE, VELOCITY, Attach, Point, Rotation, Velocity
from nuno_cloth.models.sheet import CELLS, CellKind
from nuno_cloth.models.skirt_cut import SHARES, Cut
from nuno_cloth.models.skirt_over import AtWaist, Wearing
from nuno_cloth.quantities import EdgeLength, Flatness, Fullness, Length
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float
from nuno_schemas.plugin import Config

ROUNDING = 1e-9


class SkirtConfig(Config):
    """A cone, or a ring that is cut flat, whose top row is pinned. Columns start at +x and run towards -z.

    Texture: u runs from 0 to 1 around the waist, to the right as seen from outside, so that an image goes round once
    and its sides meet where columns begin, at the left side; v is 1 at the waist and 0 at the hem.
    """

    over: AtWaist | None = Field(
        default=None, description="the body that wears it, from which waist, place and width follow; none: as if in air"
    )
    cut: Cut = Field(
        default="cone",
        description="cone: as wide as hem_radius and fullness say; circle, half, quarter: that part of a flat ring, "
        "whose inner rim is the waist, in triangles",
    )
    waist_radius: Length = Field(default=0.13, description="of the waist, half its width [m]")
    hem_radius: Length = Field(
        default=0.28,
        description="of the circle on which the hem starts [m]; not given, over a body: as wide as hips and legs need; "
        "of a ring: as wide as it is cut, if there is room",
    )
    length: Length = Field(default=0.5, description="along the cloth, from waist to hem [m]")
    columns: int = Field(default=128, ge=4, le=16384, description="vertices around, an even number")
    rows: int = Field(default=64, ge=2, le=16384, description="vertices from waist to hem")
    fullness: Fullness = Field(default=1.0, description="the cloth's length at the hem over the circle it starts on")
    pleats: int = Field(default=12, ge=2, le=200, description="folds around with which it starts, where it has any")
    edge: EdgeLength = Field(default=0.015, description="length of a ring's triangles' edges [m]")
    ratio: Flatness = Field(default=1.0, description="the waist's depth over its width, z over x")
    centre: Point = Field(default=(0.0, 0.0, 0.0), description="middle of the waist [m]")
    rotate: Rotation | None = Field(
        default=None, description="a turn about the centre; before it the axis points down (-y)"
    )
    velocity: Velocity = Field(default=STILL, description=VELOCITY)
    cells: CellKind = Field(default="quads", description=CELLS)
    attach: Attach | None = Field(
        default=None,
        description="the body and frame that the waist moves with; not given: the body that it is over, else it stands",
    )
    fabric: FabricChoice = Field(default="denim", description=FABRIC)
    texture: str | None = Field(default=None, description=TEXTURE)

    @field_validator("columns")
    @classmethod
    def _even(cls, columns: int) -> int:
        if columns % 2:
            raise ValueError("must be even, so that alternating diagonals close around the tube")
        return columns

    @model_validator(mode="after")
    def _of_one_kind(self) -> SkirtConfig:
        placed = {"waist_radius", "ratio", "centre", "rotate"} & self.model_fields_set
        if self.over is not None and placed:
            raise ValueError(f"a skirt over a body takes its waist from it: leave {', '.join(sorted(placed))} out")
        if self.cut == "cone" and "edge" in self.model_fields_set:
            raise ValueError("a cone has columns and rows: leave edge out, or choose cut: circle, half or quarter")
        rows = {"columns", "rows", "cells", "fullness"} & self.model_fields_set
        if self.cut != "cone" and rows:
            raise ValueError(
                f"a ring has its fullness and triangles by cut and edge: leave {', '.join(sorted(rows))} out"
            )
        return self


def require_measures(config: SkirtConfig, waist: float, hem: float) -> None:
    """Raise BadInput if a skirt cannot start with circles of these radii [m], or has too few columns to fold."""
    ring = config.cut != "cone"
    widest = waist + config.length * (SHARES[config.cut] if ring else 1.0)
    if (hem > widest * (1.0 + ROUNDING)) if ring else abs(hem - waist) >= config.length:
        raise BadInput(
            "the hem would be wider than it is cut" if ring else "the hem lies further out than the cloth is long",
            field="hem_radius",
            value=hem,
            limit=f"{widest:g} m" if ring else f"less than {config.length:g} m from waist_radius {waist:g} m",
            remedy="leave it out" if ring else "make the skirt longer; for more cloth at the hem raise fullness",
        )
    if config.fullness > 1:
        require_columns(config)


def require_columns(config: SkirtConfig) -> None:
    """Raise BadInput for a cone with too few columns to fold."""
    if config.cut == "cone" and config.columns < 8 * config.pleats:
        raise BadInput(
            "too few columns to show the pleats",
            field="columns",
            value=config.columns,
            limit=f"at least 8 for each of {config.pleats} pleats",
            remedy=f"columns: {8 * config.pleats}, or fewer pleats",
        )


def require_width(config: SkirtConfig, circle: Float, wearing: Wearing, ease: float) -> None:
    """Raise BadInput if rows, cut `circle` (rows,) long [m], are too short to go round the body."""
    short = wearing.least - circle
    row = int(np.argmax(short))
    if short[row] > ROUNDING:
        most = f"{np.ceil(1e3 * (ease + short[row])) / 10.0:g} cm"
        down = 100.0 * config.length * row / (len(circle) - 1)
        raise BadInput(
            "the skirt is too narrow for the body", field="hem_radius" if config.cut == "cone" else "cut",
            value=f"{100.0 * circle[row]:.4g} cm round, {down:.3g} cm below the waist",
            limit=f"at least {100.0 * wearing.least[row]:.4g} cm there",
            remedy="leave hem_radius out" if config.cut == "cone" else f"ease: {most}, or more of a circle",
        )  # fmt: skip
