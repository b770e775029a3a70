"""A pattern's file, as GarmentCode writes it (Korosteleva & Sorkine-Hornung 2023, ACM Trans. Graph. 42, 199).

Lengths are in the file's own unit, `units_in_meter` of which are a metre. Beyond GarmentCode's fields a panel may have
a `grain`. nuno_cloth.sewing.assemble checks relations between fields, such as which edges meet.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from nuno_schemas.plugin import Config

LARGEST = 1e6
Number = Annotated[float, Field(ge=-LARGEST, le=LARGEST, allow_inf_nan=False)]
Point = tuple[Number, Number]
Triple = tuple[Number, Number, Number]


class Quadratic(Config):
    type: Literal["quadratic"]
    params: tuple[Point] = Field(description="the control point", examples=[[[0.5, 0.1]]])


class Cubic(Config):
    type: Literal["cubic"]
    params: tuple[Point, Point] = Field(description="the two control points", examples=[[[0.3, 0.1], [0.7, 0.1]]])


class Circle(Config):
    type: Literal["circle"]
    params: tuple[Annotated[float, Field(gt=0, le=LARGEST)], bool, bool] = Field(
        description="radius, 1 for the longer arc of the circle, 1 if it bulges to the right of the way along the edge",
        examples=[[30, 0, 1]],
    )


def _as_curve(value: Any) -> Any:
    """Return one control point, as files of 2021 have it, as a curve (Korosteleva & Lee 2021, Generating Datasets of 3D
    Garments with Sewing Patterns).
    """
    return {"type": "quadratic", "params": [value]} if isinstance(value, list | tuple) else value


class EdgeFields(Config):
    endpoints: tuple[int, int] = Field(
        description="numbers of the vertices where it starts and ends", examples=[[0, 1]]
    )
    curvature: Annotated[
        Annotated[Quadratic | Cubic | Circle, Field(discriminator="type")] | None, BeforeValidator(_as_curve)
    ] = None
    label: str | None = None


class PanelFields(Config):
    vertices: tuple[Point, ...] = Field(
        min_length=2, max_length=400, description="in the file's unit", examples=[[[-36, 0], [36, 0], [24, 60]]]
    )
    edges: tuple[EdgeFields, ...] = Field(min_length=2, max_length=400, description="in order round the panel")
    translation: Triple = Field(default=(0.0, 0.0, 0.0), examples=[[0, 45, 20]])
    rotation: Triple = Field(
        default=(0.0, 0.0, 0.0), description="about x, then the new y, then the new z [deg]", examples=[[0, 90, 0]]
    )
    label: str | None = None
    grain: Number = Field(default=0.0, description="angle of the warp from the panel's y, counter-clockwise [deg]")


class SideFields(Config):
    panel: str
    edge: int


class PatternFields(Config):
    panels: dict[str, PanelFields] = Field(min_length=1)
    stitches: tuple[tuple[SideFields | Literal["right_wrong"], ...], ...] = Field(
        default=(), examples=[[[{"panel": "front", "edge": 1}, {"panel": "back", "edge": 2}]]]
    )
    panel_order: tuple[str, ...] = ()


class Properties(Config):
    units_in_meter: Annotated[
        float, Field(gt=0, le=LARGEST, allow_inf_nan=False, description="100 for centimetres", examples=[100])
    ]
    curvature_coords: Literal["relative", "absolute"] = "relative"
    normalize_panel_translation: Literal[False] = False
    normalized_edge_loops: Literal[True] = True
    original_units_in_meter: float | None = None


class PatternFile(Config):
    """A pattern's file. `parameters` and the like, which only the drawing program needs, are ignored."""

    pattern: PatternFields
    properties: Properties = Field(examples=[{"units_in_meter": 100}])
    parameters: dict[str, Any] = Field(default_factory=dict)
    parameter_order: tuple[Any, ...] = ()
    constraints: dict[str, Any] = Field(default_factory=dict)
    constraint_order: tuple[Any, ...] = ()
