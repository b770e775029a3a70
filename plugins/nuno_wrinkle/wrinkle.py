"""The operation `wrinkle`: ridge and valley lines raised in cloth, at rest or while it moves (the wrinkle paper)."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import BaseModel, Field

from nuno_kernels import kernel
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Binding, Corners, Fabric, Float, Int, Springs, State
from nuno_schemas.operation import Changed, Outcome, Surface
from nuno_schemas.plugin import Config, Files
from nuno_schemas.units import quantity
from nuno_wrinkle.lines import Crossed, Line, Smoothing, follow_lines, on_texture, read_lines
from nuno_wrinkle.net import ON_SPRINGS, Net, Rule, build_net, describe, find_near, find_sprung, kept_rigidity
from nuno_wrinkle.raised import Raised, find_region, raise_lines
from nuno_wrinkle.surface import link_faces

# A wrinkle is measured across each new vertex, between its feet on either side of its line: unsmoothed vertices, or
# where none lies between, the next line that goes the other way, as of a valley between ridges.


@kernel
def _nearest(x: Float, feet: Int, turn: Float, vertices: Int, own: Float, across: Float, nearest: Int) -> None:
    """Find the feet (f,) nearest to each of `vertices` (m,) on the side that across (m, 3) points to, and on the other,
    within 45 degrees of it. x (n, 3); turn (f,) and own (m,) are above 0 on ridges, below in valleys, and 0 elsewhere;
    nearest (m, 2) is the result, -1 without a foot on that side.
    """
    for i in range(len(vertices)):
        best_left, best_right = np.inf, np.inf
        nearest[i, 0], nearest[i, 1] = -1, -1
        size = 0.0
        for k in range(3):
            size += across[i, k] * across[i, k]
        for j in range(len(feet)):
            side, distance = 0.0, 0.0
            for k in range(3):
                component = x[feet[j], k] - x[vertices[i], k]
                side += component * across[i, k]
                distance += component * component
            if turn[j] * own[i] > 0.0 or 2.0 * side * side < size * distance:
                continue
            if side > 0.0 and distance < best_left:
                best_left, nearest[i, 0] = distance, feet[j]
            if side < 0.0 and distance < best_right:
                best_right, nearest[i, 1] = distance, feet[j]


def find_crests(n: int, crossed: Crossed, raised: Raised) -> Int:
    """Return vertices (5, c): new ones, the nearest feet to the left and to the right of their line, and the new ones
    before and after them.

    Ends of lines, and new vertices with feet on one side only, are left out.
    """
    still = np.ones(len(raised.x), np.bool_)
    still[raised.smoothed] = False
    corners = np.zeros(len(raised.x), np.bool_)
    corners[raised.faces[raised.local]] = True
    still[n:] = True
    feet = np.flatnonzero(corners & still).astype(np.int32)
    turn = np.append(np.zeros(n), crossed.height)
    chains = [np.asarray(chain, np.int32) for chain in crossed.chains]
    before, inner, after = (
        np.concatenate([chain[part] for chain in chains]) for part in (np.s_[:-2], np.s_[1:-1], np.s_[2:])
    )
    along = raised.flat[n + after] - raised.flat[n + before]
    pair = np.empty((len(inner), 2), np.int32)
    across = np.cross(raised.normal[inner], along)
    _nearest(raised.flat, feet, turn[feet], n + inner, crossed.height[inner], across, pair)
    crests = np.stack([n + inner, *pair.T, n + before, n + after])
    return np.ascontiguousarray(crests[:, (pair >= 0).all(axis=1)], np.int32)


Length = Annotated[float, quantity("m", gt=0)]
Tensile = Annotated[float, quantity("N/m", gt=0)]


class WrinkleConfig(Config):
    """Lines, and the treatment of the cloth near them."""

    lines: tuple[Line, ...] = Field(min_length=1, max_length=1000, description="ridges and valleys")
    tolerance: Length | Literal["auto"] = Field(
        default="auto", description="how far from the cloth points may lie [m]; auto: the mean length of its springs"
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

    def require(self, config: WrinkleConfig, fabric: Fabric) -> None:
        """Raise BadInput for cloth that cannot have such a line, wherever it moves."""
        _require_triangles(fabric)
        describe(fabric)
        if config.keep and fabric.hinges is None:
            remedy = "give the fabric a bending stiffness: a preset, or hinge by hand"
            raise BadInput("a wrinkle is kept by folds, and this cloth has no hinges", field="keep", remedy=remedy)
        for i, line in enumerate(config.lines):
            if line.texture is not None:
                on_texture(fabric, i)
        if not find_sprung(fabric).any():
            raise BadInput("the triangles of the cloth have no spring along an edge", field="object", remedy=ON_SPRINGS)

    def apply(self, config: WrinkleConfig, fabric: Fabric, state: State, skin: Surface | None) -> Outcome:
        """Return the fabric with its lines raised at `state`. Raises BadInput without a change."""
        self.require(config, fabric)
        model = dict(fabric.origin) if "r_avg" in fabric.origin else describe(fabric)
        used = model | ({} if config.k_std == "auto" else {"k_std": config.k_std})
        size = float(np.linalg.norm(np.ptp(state.x, axis=0)))
        for i, line in enumerate(config.lines):
            if line.file is not None:
                raise BadInput("the file has not been read", field=f"lines[{i}].file", value=line.file)
            if abs(line.height) >= size:
                raise BadInput(
                    "the line is raised further than the cloth is large", field=f"lines[{i}].height",
                    value=line.height, limit=f"{size:.4g} m", remedy="a smaller height",
                )  # fmt: skip
        across = link_faces(fabric.faces, fabric.number)
        tolerance = model["r_avg"] if config.tolerance == "auto" else config.tolerance
        crossed = follow_lines(fabric, state.x, across, config.lines, tolerance)
        region = find_region(fabric.faces, fabric.number, crossed)
        near = find_near(fabric, state.x, region)
        raised = raise_lines(fabric, state.x, across, crossed, config.smoothing, region, near.stretch)
        crests = find_crests(fabric.number, crossed, raised)
        kept = kept_rigidity(model["density"], raised.x, crests, fabric.number) if config.keep else None
        net = build_net(fabric, across, raised, near, region, used, config.springs, kept)
        return _outcome(fabric, state, crossed, raised, net, model, crests)


def _require_triangles(fabric: Fabric) -> None:
    if fabric.corners is not None and fabric.corners.panels is not None:
        raise BadInput("lines are not drawn on cloth that is sewn of panels", field="object")
    springs = fabric.springs
    if not len(fabric.faces) or fabric.yarns is not None or (springs is not None and springs.lock is not None):
        raise BadInput("lines are drawn on cloth of triangles, which this is not", field="object", remedy=ON_SPRINGS)


def _outcome(
    fabric: Fabric, state: State, crossed: Crossed, raised: Raised, net: Net, model: dict[str, float], crests: Int
) -> Outcome:
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
        uv=None if fabric.uv is None else extended(fabric.uv),  # type: ignore[arg-type]
        corners=None if raised.uv is None else Corners.of(raised.faces, raised.uv),
        bindings=tuple(_extend_binding(binding, fabric, crossed) for binding in fabric.bindings),
        origin=model,
    )
    m = len(crossed.face)
    source = np.append(np.arange(fabric.number, dtype=np.int32), np.full(m, -1, np.int32))
    facts = {
        "lines": float(len(crossed.chains)),
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
