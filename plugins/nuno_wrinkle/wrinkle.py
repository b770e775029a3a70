"""The operation `wrinkle`: ridge and valley lines raised in cloth, at rest or while it moves (the wrinkle paper)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import BaseModel, Field, model_validator
from pydantic_core import PydanticCustomError

from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Binding, Corners, Fabric, Float, Int, Relief, Springs, State
from nuno_schemas.operation import Changed, Outcome, Surface
from nuno_schemas.plugin import Config, Files
from nuno_schemas.units import quantity
from nuno_wrinkle.lines import Crossed, Line, Smoothing, follow_lines, on_texture, read_lines
from nuno_wrinkle.net import ON_SPRINGS, Net, Rule, build_net, describe, find_near, find_sprung, kept_rigidity
from nuno_wrinkle.raised import Raised, find_region, raise_lines
from nuno_wrinkle.relief import find_crests, number_lines, raise_rest, sides_of
from nuno_wrinkle.surface import link_faces


def _find_crests(n: int, crossed: Crossed, raised: Raised) -> Int:
    """Return the crests of new vertices; feet are vertices that are not smoothed, and new ones."""
    still = np.ones(len(raised.x), np.bool_)
    still[raised.smoothed] = False
    corners = np.zeros(len(raised.x), np.bool_)
    corners[raised.faces[raised.local]] = True
    still[n:] = True
    chains = [np.asarray(n + chain, np.int32) for chain in crossed.chains]
    turn, normal = np.append(np.zeros(n), crossed.height), np.concatenate([np.zeros((n, 3)), raised.normal])
    return find_crests(raised.flat, normal, chains, turn, np.flatnonzero(corners & still).astype(np.int32))


Length = Annotated[float, quantity("m", gt=0)]
Tensile = Annotated[float, quantity("N/m", gt=0)]


SPLITTING = ("smoothing", "springs", "k_std")
"""Fields for lines without a width."""


class WrinkleConfig(Config):
    """Lines, and the treatment of the cloth near them."""

    lines: tuple[Line, ...] = Field(default=(), max_length=1000, description="ridges and valleys")
    take_back: tuple[Annotated[int, Field(ge=1)], ...] = Field(
        default=(),
        max_length=1000,
        description="numbers of lines with a width whose rest shape returns to what it was without them, before others "
        "are drawn: from 1, in the order in which lines were drawn on the object",
    )
    tolerance: Length | Literal["auto"] = Field(
        default="auto", description="how far from the cloth points may lie [m]; auto: the mean length of its edges"
    )
    smoothing: Smoothing = Field(default=Smoothing(), description="of new vertices and their two-ring")
    springs: Rule = Field(
        default="paper",
        description="stiffness of new springs of rest length r: paper, (r / r_avg) k_std; physical, k_std r_avg / r",
    )
    k_std: Tensile | Literal["auto"] = Field(
        default="auto", description="stiffness of a spring of mean length [N/m]; auto: the mean of the cloth's springs"
    )
    keep: bool = Field(
        default=False, description="whether folds of the lines are at rest, and stiffer, so that they do not fade"
    )

    @model_validator(mode="after")
    def _suits_widths(self) -> WrinkleConfig:
        wide = [line.width is not None for line in self.lines]
        others = sorted(self.model_fields_set & set(SPLITTING)) if all(wide) else []
        problem, inside = "", tuple[str | int, ...](["lines"])
        if not (self.lines or self.take_back):
            problem = "draw lines, or take some back: lines: [...], take_back: [1]"
        elif any(wide) and not all(wide):
            problem, inside = "lines with a width and without are two operations", ("lines", wide.index(False))
        elif others:
            problem, inside = "this is for lines without a width, which split triangles: leave it out", (others[0],)
        if problem:
            raise PydanticCustomError("widths", problem, {"inside": inside})
        return self

    @property
    def raises(self) -> bool:
        """Whether no line splits triangles."""
        return all(line.width is not None for line in self.lines)


class Wrinkle:
    """Raises ridges and valleys. A refused line changes nothing."""

    name: ClassVar[str] = "wrinkle"
    Config: ClassVar[type[BaseModel]] = WrinkleConfig

    def compile(self) -> None:
        """Compile the kernels by a line on two triangles."""
        x = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
        pairs = np.array([[0, 1], [1, 2], [2, 3], [0, 3], [0, 2]], np.int32)
        one = np.ones(len(pairs))
        springs = Springs.from_pairs(pairs, one, np.linalg.norm(x[pairs[:, 1]] - x[pairs[:, 0]], axis=1), 0.0 * one)
        faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
        cloth = Fabric(self.name, x, 0.0 * x, np.ones(4), np.zeros(4, np.bool_), faces, springs)
        line = Line(points=((0.6, 0.2, 0.0), (0.2, 0.6, 0.0)), height=0.1)
        self.apply(WrinkleConfig(lines=(line,)), cloth, State(x, 0.0 * x), None)

    def resolve(self, config: WrinkleConfig, files: Files) -> WrinkleConfig:
        """Return the configuration with lines of files as points. Raises BadInput."""
        return config.model_copy(update={"lines": read_lines(config.lines, files)})

    def require(self, config: WrinkleConfig, fabric: Fabric, earlier: Sequence[WrinkleConfig]) -> None:
        """Raise BadInput for cloth that cannot have such a line, wherever it moves, after `earlier` ones, and for a
        line that is taken back but not there.
        """
        _require_cloth(config, fabric)
        for one in (*earlier, config):
            fabric = replace(fabric, relief=number_lines(fabric, one.take_back, one.lines))

    def apply(self, config: WrinkleConfig, fabric: Fabric, state: State, skin: Surface | None) -> Outcome:
        """Return the fabric with its lines raised at `state`. Raises BadInput without a change."""
        _require_cloth(config, fabric)
        size = float(np.linalg.norm(np.ptp(state.x, axis=0)))
        for i, line in enumerate(config.lines):
            if line.file is not None:
                raise BadInput("the file has not been read", field=f"lines[{i}].file", value=line.file)
            if abs(line.height) >= size:
                raise BadInput(
                    "the line is raised further than the cloth is large", field=f"lines[{i}].height",
                    value=line.height, limit=f"{size:.4g} m", remedy="a smaller height",
                )  # fmt: skip
        if config.raises:
            tolerance = None if config.tolerance == "auto" else config.tolerance
            return raise_rest(config.lines, config.keep, config.take_back, tolerance, fabric, state)
        relief = number_lines(fabric, config.take_back, config.lines)
        model = dict(fabric.origin) if "r_avg" in fabric.origin else describe(fabric)
        used = model | ({} if config.k_std == "auto" else {"k_std": config.k_std})
        across = link_faces(fabric.faces, fabric.number)
        tolerance = model["r_avg"] if config.tolerance == "auto" else config.tolerance
        crossed = follow_lines(fabric, state.x, across, config.lines, tolerance)
        region = find_region(fabric.faces, fabric.number, crossed)
        near = find_near(fabric, state.x, region)
        raised = raise_lines(fabric, state.x, across, crossed, config.smoothing, region, near.stretch)
        crests = _find_crests(fabric.number, crossed, raised)
        kept = kept_rigidity(model["density"], raised.x, crests, fabric.number) if config.keep else None
        net = build_net(fabric, across, raised, near, region, used, config.springs, kept)
        return _outcome(fabric, state, crossed, raised, net, model, crests, relief)


def _require_cloth(config: WrinkleConfig, fabric: Fabric) -> None:
    """Raise BadInput for cloth that cannot have such lines in any state."""
    springs = fabric.springs
    if not len(fabric.faces) or fabric.yarns is not None or (springs is not None and springs.lock is not None):
        raise BadInput("lines are drawn on cloth of triangles, which this is not", field="object", remedy=ON_SPRINGS)
    for i, line in enumerate(config.lines):
        if line.texture is not None:
            on_texture(fabric, i)
    if config.raises:
        sides_of(fabric)
        return
    if fabric.membrane is not None or (fabric.corners is not None and fabric.corners.panels is not None):
        problem = "a membrane and sewn cloth keep their triangles, which a line without a width would split"
        raise BadInput(problem, field="lines[0].width", remedy=ON_SPRINGS)
    describe(fabric)
    if config.keep and fabric.hinges is None:
        remedy = "give the fabric a bending stiffness: a preset, or hinge by hand; or the line a width"
        raise BadInput("a wrinkle is kept by folds, and this cloth has no hinges", field="keep", remedy=remedy)
    if not find_sprung(fabric).any():
        raise BadInput("the triangles of the cloth have no spring along an edge", field="object", remedy=ON_SPRINGS)


def _outcome(
    fabric: Fabric, state: State, crossed: Crossed, raised: Raised, net: Net, model: dict[str, float], crests: Int,
    relief: Relief,
) -> Outcome:  # fmt: skip
    corners = fabric.faces[crossed.face]

    def extended(values: Float) -> Float:
        """Return values with those of new vertices, interpolated between their corners, at the end."""
        between = np.einsum("mc,mc...->m...", crossed.at, values[corners].astype(np.float64))
        return np.ascontiguousarray(np.concatenate([values, between.astype(values.dtype)]))

    held = fabric.pinned[corners].all(axis=1)
    changed = replace(
        fabric,
        position=extended(fabric.position),
        velocity=extended(fabric.velocity),
        mass=net.mass,
        pinned=np.append(fabric.pinned, held),
        faces=raised.faces,
        springs=net.springs,
        hinges=net.hinges,
        relief=relief,
        uv=None if fabric.uv is None else extended(fabric.uv),  # type: ignore[arg-type]
        corners=None if raised.uv is None else Corners.of(raised.faces, raised.uv),
        bindings=tuple(_extend_binding(binding, fabric, crossed) for binding in fabric.bindings),
        origin=model,
    )
    m = len(crossed.face)
    source = np.append(np.arange(fabric.number, dtype=np.int32), np.full(m, -1, np.int32))
    facts = {
        "lines": float(len(crossed.chains)),
        "first": float(len(relief.kind) - len(crossed.chains) + 1),
        "vertices": float(m),
        "smoothed": float(len(raised.smoothed)),
        "held": float(raised.held),
        "flipped": float(raised.flipped),
        "left": float(raised.left),
        "area": net.added,
        "mass": float(net.mass.sum() - fabric.mass.sum()),
    }
    after = State(np.ascontiguousarray(raised.x), extended(state.v), state.t)
    return Outcome(facts, arrays={"crests": crests}, changed=Changed(changed, after, source))


def _extend_binding(binding: Binding, fabric: Fabric, crossed: Crossed) -> Binding:
    """Return the binding with the new vertices whose corners it all holds."""
    place = np.full(fabric.number, -1, np.int64)
    place[binding.vertices] = np.arange(len(binding.vertices))
    corners = place[fabric.faces[crossed.face]]
    selected = (corners >= 0).all(axis=1)
    if not selected.any():
        return binding
    vertices = np.append(binding.vertices, fabric.number + np.flatnonzero(selected)).astype(np.int32)
    if binding.local is None:
        return replace(binding, vertices=vertices)
    between = np.einsum("mc,mck->mk", crossed.at[selected], binding.local[corners[selected]])
    return replace(binding, vertices=vertices, local=np.concatenate([binding.local, between]))
