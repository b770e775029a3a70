"""A simple shirt, cut to the measures of a body and put on it: a tube with shoulders, a neck and two short sleeves."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Field

from nuno_cloth.fabrics.material import FABRIC, FabricChoice, resolve
from nuno_cloth.models.bending_friction import bytes_of_friction
from nuno_cloth.models.dress import Fit, dress
from nuno_cloth.models.membrane import BYTES_PER_VERTEX, TENSION, Tension, build_elements
from nuno_cloth.models.placement import TEXTURE, Over, Wearable, find_texture, require_bare
from nuno_cloth.models.shirt_pattern import Cut, Sewn, sew
from nuno_cloth.models.stance import check_stance
from nuno_cloth.models.triangles import find_edges
from nuno_cloth.models.wearer import STANDS, TURN, Wearer, find_wearer
from nuno_cloth.quantities import Angle, Length
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float, Int
from nuno_schemas.plugin import Config, Files

COLLAR = 0.02
"""Width of the shirt's neck beyond the wearer's, on either side [m]."""
LOWER = 0.03
"""Distance of the underarms below the armpits [m]."""
STEEPEST = 0.5
"""A steeper overarm would leave the sleeves no width at the underarm [rad]."""
LEAVES = 0.05
"""Distance from its root at which an arm is free of the trunk [m]."""
BACK = 0.3
"""Depth of the neck behind, as a share of that in front."""
SAMPLES = 9
"""Heights at which a trunk is measured."""


class ShirtConfig(Config):
    """A shirt cut to the body that wears it. nuno_cloth.models.shirt_pattern shows how it is cut and sewn."""

    over: Over = Field(description="the body that it is cut to and put on: upright, facing +z, arms off its sides")
    around: int = Field(default=100, ge=32, le=2000, description="triangles round the chest")
    length: Length = Field(default=0.6, description="from the neck's side down to the hem, along the cloth [m]")
    sleeve: Length = Field(default=0.15, description="from the shoulder along the overarm to the cuff [m]")
    ease: Length = Field(default=0.1, description="how much longer it is round the trunk than that at its widest [m]")
    cuff: Length = Field(default=0.07, description="how much longer the sleeves are round than the arms [m]")
    neckline: Length = Field(default=0.085, description="depth of the neck in front [m]")
    slope: Angle = Field(default=0.35, description="angle of the overarm below level, as it is cut [rad]")
    fabric: FabricChoice = Field(default="interlock", description=FABRIC)
    tension: Tension = Field(default="auto", description=TENSION)
    texture: str | None = Field(default=None, description=TEXTURE)


class Shirt(Wearable):
    """A shirt with one texture on front and back, without a seam, u to the right as seen from in front."""

    name: ClassVar[str] = "shirt"
    Config: ClassVar[type[BaseModel]] = ShirtConfig

    def count(self, config: ShirtConfig, files: Files) -> int:
        return len(sewn_for(STANDARD, config)[1].flat)

    def memory(self, config: ShirtConfig, files: Files, vertices: int) -> int:
        """Return the most memory that a run takes [bytes]."""
        return vertices * (BYTES_PER_VERTEX + bytes_of_friction(config.fabric))

    def build(self, config: ShirtConfig, files: Files, seed: int) -> Fabric:
        raise BadInput("a shirt is cut to a body", field="over", remedy="name a body whose collider is a mesh")

    def build_over(
        self, config: ShirtConfig, files: Files, seed: int, x: Float, faces: Int, worn: Sequence[Fabric] = ()
    ) -> Fabric:
        """Build the shirt on a body's mesh x (v, 3) [m], faces (f, 3). Raises BadInput for a body without armpits and
        arms, for one that wears a garment already, and for a shirt that would start inside of it.
        """
        require_bare(worn, self.name, config.over.body)
        check_stance(x, faces, config.over.body)
        wearer = find_wearer(x, faces)
        sizes, fit = take_measures(wearer, config)
        cut, sewn = sewn_for(sizes, config)
        edges = find_edges(sewn.faces)
        material = resolve(config.fabric)
        down = np.array([0.0, 1.0, 0.0])
        elements = build_elements(material, sewn.flat, sewn.faces, edges, down, folded=True, tension=config.tension)
        position = dress(wearer, cut, fit, sewn, edges, config.over.clearance)
        return Fabric(
            name=self.name,
            position=position,
            velocity=np.zeros_like(position),
            pinned=np.zeros(len(position), np.bool_),
            uv=texture_of(sewn),
            texture=find_texture(config.texture, files),
            **elements._asdict(),
        )


class Sizes(NamedTuple):
    """The measures of a body to which a shirt is cut [m].

    chest, hem: girths of the trunk, widest in the upper and in the lower half; neck: half the shirt's neck; down: from
    the shoulder at the neck to the underarm, over the chest; shoulder: from the neck to the arm; root, arm: girths
    of the arm where it leaves the trunk and at the cuff
    """

    chest: float
    hem: float
    neck: float
    down: float
    shoulder: float
    root: float
    arm: float


STANDARD = Sizes(0.895, 0.955, 0.088, 0.26, 0.165, 0.315, 0.271)
"""About the measures of the mannequin that comes with nuno. Every shirt has the triangles that it would have there."""


def take_measures(wearer: Wearer, config: ShirtConfig) -> tuple[Sizes, Fit]:
    """Return a body's sizes, and how a shirt of these sizes fits it. Raises BadInput if no trunk or arm is found."""
    neck = wearer.neck[0] + COLLAR
    height = wearer.top(neck)
    drop = height - wearer.armpit + LOWER
    chest, root = wearer.trunk(wearer.armpit - LOWER), wearer.across(wearer.arms[0], 0.0)
    distances = np.linspace(LEAVES, max(config.sleeve, 2.0 * LEAVES), 4)
    arms = [
        loop.girth for distance in distances if (loop := wearer.across(wearer.arms[0], float(distance))) is not None
    ]
    if chest is None or root is None or not arms:
        raise BadInput(
            "no trunk and arms are found on this body where its armpits seem to be", field="over.body",
            limit=STANDS, remedy=TURN,
        )  # fmt: skip
    # The chest stands out by half its depth: the cloth over it is longer than the drop.
    deep = 0.5 * float(np.ptp(chest.points[:, 2]))
    down = float(np.hypot(drop, deep))
    levels = height - drop - np.linspace(0.0, max(config.length - down, LOWER), SAMPLES)
    girths = [loop.girth for y in levels if (loop := wearer.trunk(float(y))) is not None]
    half = len(girths) // 2
    top = root.points[np.argmax(root.points[:, 1])]
    shoulder = float(np.hypot(abs(top[0] - wearer.middle) - neck, top[1] - height))
    sizes = Sizes(
        max(girths[: half + 1]), max(girths[half:]), neck, down, shoulder, arms[0], max(arms[len(arms) // 2 :])
    )
    return sizes, Fit(shoulder, height, deep)


def cut_to(sizes: Sizes, config: ShirtConfig) -> Cut:
    """Return the cut for a body of these sizes. Raises BadInput for an overarm that is too steep."""
    slope = float(config.slope)
    if not 0.0 <= slope <= STEEPEST:
        raise BadInput(
            "no shirt is cut with such an overarm", field="slope", value=f"{np.degrees(slope):.3g} deg",
            limit=f"0 to {np.degrees(STEEPEST):.3g} deg", remedy="cut it less steep: the cloth bends with the arms",
        )  # fmt: skip
    width = 0.25 * (sizes.chest + config.ease)
    # The sleeve is as wide at the underarm as the arm is where it leaves the trunk, with the cuff's ease.
    wide = 0.5 * (sizes.root + config.cuff)
    least = (wide + (width - sizes.neck) * np.sin(slope)) / np.cos(slope)
    return Cut(
        width=width,
        hem=0.25 * (sizes.hem + config.ease),
        length=config.length,
        depth=max(sizes.down, float(least)),
        neck=sizes.neck,
        front=config.neckline,
        back=BACK * config.neckline,
        overarm=sizes.shoulder + config.sleeve,
        cuff=0.5 * (sizes.arm + config.cuff),
        slope=slope,
    )


def sewn_for(sizes: Sizes, config: ShirtConfig) -> tuple[Cut, Sewn]:
    """Return the cut and the sewn shirt for a body of these sizes. Raises BadInput for sizes that give no pattern."""
    cut, standard = cut_to(sizes, config), cut_to(STANDARD, config)
    return cut, sew(cut, standard, 4.0 * standard.width / config.around)


def texture_of(sewn: Sewn) -> NDArray[np.float32]:
    """Return texture coordinates (n, 2): the flat shirt, at one scale in u and v, in the middle of the image."""
    low, high = sewn.flat[:, :2].min(axis=0), sewn.flat[:, :2].max(axis=0)
    uv = 0.5 + (sewn.flat[:, :2] - 0.5 * (low + high)) / (high - low).max()
    return np.ascontiguousarray(uv, np.float32)
