"""Plain knit, flat or a tube, of any yarns in turn: the knit paper's two-yarn stocking is one of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import BaseModel, Field, field_validator, model_validator

from nuno_knit.quantities import (
    Length,
    LinearDensity,
    Mass,
    Metres,
    Newtons,
    Rate,
    Ratio,
    Share,
    SpringDamping,
    Stiffness,
)
from nuno_knit.structure import Knit as Structure
from nuno_knit.structure import Over, draw_over
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Bool, Fabric, Float, Int, Springs, Yarns
from nuno_schemas.plugin import Config, Files
from nuno_schemas.preset import Measure, Preset

# Yarns to knit with, in physical units, each with its source.

DTEX = 1e-7
"""kg/m in one dtex."""
MU = 0.2
"""Share of its neighbours' tension that passes to a link: the knit paper's value for both yarns."""


class Yarn(Config):
    """A yarn: its stiffness as `ea` of the yarn or `k` of each link, and its density.

    A yarn that locks, such as a covered one, has tension ea e up to the strain e = lock, which grows by ea_lock from
    there.
    """

    name: str = Field(default="yarn", min_length=1, max_length=64, description="for reports and pictures")
    ea: Newtons | None = Field(default=None, description="tensile stiffness, force per strain [N]")
    k: Stiffness | None = Field(default=None, description="of every link instead, whatever its length [N/m]")
    lock: Ratio | None = Field(default=None, description="strain at which it locks; left out: it never does")
    ea_lock: Newtons | None = Field(default=None, description="tensile stiffness from there on, instead of ea [N]")
    k_lock: Stiffness | None = Field(default=None, description="of every link from there on, instead of k [N/m]")
    density: LinearDensity = Field(default=22 * DTEX, description='linear density, for example "22 dtex" [kg/m]')
    mu: Share = Field(default=MU, description="share of its neighbours' tension that a link takes over, below 1/2")
    length: Ratio = Field(default=1.0, description="rest length of its links, as a ratio of the knit's spacing")
    c: SpringDamping = Field(default=0.0, description="damping along every link [N*s/m]")

    @field_validator("mu")
    @classmethod
    def _has_an_energy(cls, mu: float) -> float:
        if mu >= 0.5:
            raise ValueError("must be below 1/2: from there on a long yarn's energy has no minimum")
        return mu

    @model_validator(mode="after")
    def _one_stiffness(self) -> Yarn:
        if (self.ea is None) == (self.k is None):
            raise ValueError("give ea, the yarn's stiffness, or k, that of a link: one of them")
        return self

    @model_validator(mode="after")
    def _locks(self) -> Yarn:
        slack, locked, other = (
            (self.ea, self.ea_lock, self.k_lock) if self.k is None else (self.k, self.k_lock, self.ea_lock)
        )
        if other is not None or (self.lock is None) != (locked is None):
            names = ("ea", "ea_lock") if self.k is None else ("k", "k_lock")
            raise ValueError(f"a yarn of {names[0]} locks by lock and {names[1]}, both or neither")
        if slack is not None and locked is not None and locked < slack:
            raise ValueError("a yarn that locks grows stiffer: below lock its stiffness must not be greater")
        return self

    def stiffness(self, rest: float) -> float:
        """Return the stiffness of a link of rest length [m]: [N/m]."""
        return _of_link(self.ea, self.k, rest)

    def locked(self, rest: float) -> tuple[float, float]:
        """Return the strain at which a link of rest length [m] locks (or 0), and its stiffness from there [N/m]."""
        if self.lock is None:
            return 0.0, self.stiffness(rest)
        return self.lock, _of_link(self.ea_lock, self.k_lock, rest)


def _of_link(ea: float | None, k: float | None, rest: float) -> float:
    if k is not None:
        return k
    assert ea is not None
    return ea / rest


@dataclass(frozen=True)
class YarnPreset:
    """A yarn that scenes can name, and the source of its numbers."""

    yarn: Yarn
    source: str


PRESETS: dict[str, YarnPreset] = {
    "nylon": YarnPreset(
        Yarn(name="nylon", ea=6.6, density=22 * DTEX),
        "nylon 6.6, medium tenacity, 22 dtex: initial modulus 3.0 N/tex, Morton & Hearle, Physical Properties of "
        "Textile Fibres, table 13.2",
    ),
    "nylon-6": YarnPreset(
        Yarn(name="nylon-6", ea=1.3, density=22 * DTEX),
        "nylon 6, 22 dtex: initial modulus 0.6 N/tex, Morton & Hearle, table 13.2",
    ),
    "elastane": YarnPreset(
        Yarn(name="elastane", ea=0.024, density=22 * DTEX),
        "elastane, 22 dtex, 0.011 N/tex: an assumption of the order of spandex filaments, not measured",
    ),
    "support": YarnPreset(
        Yarn(name="support", ea=0.024, lock=2.0, ea_lock=6.6, density=44 * DTEX),
        "22 dtex of elastane covered with 22 dtex of nylon 6.6: the core carries as elastane does until the cover is "
        "straight and carries as nylon does; that it is at three times the rest length, a covering draft of 3, is "
        "assumed",
    ),
}

YarnName = Literal["nylon", "nylon-6", "elastane", "support"]


def _preset(name: str, preset: YarnPreset) -> Preset:
    yarn = preset.yarn
    measures = (
        Measure("EA", "N", yarn.ea),
        Measure("lock", "", yarn.lock),
        Measure("EA_lock", "N", yarn.ea_lock),
        Measure("density", "dtex", yarn.density / DTEX),
        Measure("mu", "", yarn.mu),
    )
    return Preset(name, preset.source, measures)


def resolve(choice: YarnName | Yarn) -> Yarn:
    """Return the yarn that a scene names or defines."""
    return PRESETS[choice].yarn if isinstance(choice, str) else choice


Number = Annotated[int, Field(ge=1, le=8192)]
PinName = Literal["top-row", "bottom-row", "left-edge", "right-edge", "all-rim"]
BYTES_PER_POINT = 1300
"""Peaks of recorded runs of 90,000 points against 6,400: 755 bytes a point with an explicit solver, 1,252 with an
implicit one, whose matrix takes 136 for the links and 144 for the pairs of links."""


class KnitConfig(Config):
    """A panel or a tube of plain knit."""

    wales: Number = Field(default=32, description="columns of stitches; two columns of points each")
    courses: Number = Field(default=32, description="rows of stitches; one more row of points")
    form: Literal["panel", "tube"] = Field(
        default="panel", description="panel: flat in x and y, seen from +z; tube: round the y axis"
    )
    spacing: tuple[Length, Length] = Field(
        default=(5e-4, 5e-4), description="rest length of arcs, half a wale, and of legs, a course [m]"
    )
    stretch: tuple[Ratio, Ratio] = Field(
        default=(1.0, 1.0), description="how much wider and higher than at rest it starts"
    )
    yarns: tuple[YarnName | Yarn, ...] = Field(
        default=("nylon", "support"), min_length=1, max_length=64, description="of the courses, in turn from the bottom"
    )
    mass: Mass | None = Field(default=None, description="of every point; left out: the yarns' own [kg]")
    frequency: Rate | None = Field(
        default=None,
        description="or one for every point: its mass is the stiffness about it, over the square of this "
        "[1/s]; where only rest matters",
    )
    pin: tuple[PinName, ...] = Field(
        default=(), description="points that are held, by name; both end rows, of a tube over a body"
    )
    centre: tuple[Metres, Metres, Metres] = Field(default=(0.0, 0.0, 0.0), description="of the knit [m]")
    over: Over | None = Field(default=None, description="a body that a tube is drawn over; its size follows from it")

    @model_validator(mode="after")
    def _fits_over(self) -> KnitConfig:
        if self.mass is not None and self.frequency is not None:
            raise ValueError("give mass or frequency, not both")
        conflicting = {"stretch", "centre", "pin"} & self.model_fields_set
        if self.over is not None and conflicting:
            raise ValueError(f"a knit over a body takes its place from it: leave {', '.join(sorted(conflicting))} out")
        if self.over is not None and self.form != "tube":
            raise ValueError("only a tube can be drawn over a body: write form: tube")
        return self


class Knit:
    """A net of yarns: points where they cross, links between, tension passing along each course."""

    name: ClassVar[str] = "knit"
    Config: ClassVar[type[BaseModel]] = KnitConfig

    def count(self, config: KnitConfig, files: Files) -> int:
        return structure(config).points

    def memory(self, config: KnitConfig, files: Files, vertices: int) -> int:
        """Return the most memory that a run takes [bytes]."""
        return vertices * BYTES_PER_POINT

    def yarns(self) -> tuple[Preset, ...]:
        """Return the yarns that scenes may name, in units of scenes."""
        return tuple(_preset(name, preset) for name, preset in PRESETS.items())

    def over(self, config: KnitConfig) -> str | None:
        """Return the name of the body that it is drawn over, or None."""
        return None if config.over is None else config.over.body

    def build(self, config: KnitConfig, files: Files, seed: int) -> Fabric:
        """Build the knit. Raises BadInput for a tube of fewer than two wales, and for edges of a tube."""
        net = structure(config)
        legs, arcs = np.full(net.courses, config.spacing[1]), np.full(net.courses + 1, config.spacing[0])
        return self._knit(config, net, place(config, net), net.spread(legs, arcs), _pin(config, net))

    def build_over(
        self, config: KnitConfig, files: Files, seed: int, x: Float, faces: Int, worn: Sequence[Fabric] = ()
    ) -> Fabric:
        """Build the knit over a body's mesh x (v, 3) [m], faces (f, 3), beneath garments that are `worn`. Raises
        BadInput if it does not fit.
        """
        assert config.over is not None
        net = structure(config)
        spacing = config.spacing if "spacing" in config.model_fields_set else None
        fitted = draw_over(config.over, net, spacing, x, faces)
        pinned = np.zeros((net.courses + 1, net.columns), bool)
        pinned[[0, -1]] = True
        return self._knit(config, net, fitted.position, net.spread(fitted.legs, fitted.arcs), pinned.reshape(-1))

    def _knit(self, config: KnitConfig, net: Structure, position: Float, spacing: Float, pinned: Bool) -> Fabric:
        """Return links between points at `position` (n, 3) [m], with rest lengths (s,) [m] times yarns' ratios."""
        used = [resolve(choice) for choice in config.yarns]
        pairs, springs, yarns = net.pairs(), *knit_yarns(net, used, spacing)
        if config.frequency is not None:
            # The sum of k (1 + 2 mu) over a point's links, twice, over its mass bounds its squared frequency.
            mu = np.zeros(springs.number)
            mu[yarns.links] = np.repeat(yarns.mu, np.diff(yarns.ptr))
            stiffness = springs.per_spring(springs.stiffest().k) * (1.0 + 2.0 * mu)
            mass = add_to_ends(net.points, pairs, stiffness) / config.frequency**2
        elif config.mass is not None:
            mass = np.full(net.points, config.mass)
        else:
            course, _ = net.course()
            density = np.array([yarn.density for yarn in used])[course % len(used)]
            mass = add_to_ends(net.points, pairs, 0.5 * density * springs.rest)
        return Fabric(
            name=self.name,
            position=position,
            velocity=np.zeros((net.points, 3)),
            mass=mass,
            pinned=pinned,
            faces=np.zeros((0, 3), np.int32),
            springs=springs,
            yarns=yarns,
            cells=net.cells(),
        )


def add_to_ends(points: int, pairs: Int, value: Float) -> Float:
    """Return sums (points,) of the values (s,) of each point's links (s, 2)."""
    return np.asarray(np.bincount(pairs.reshape(-1), np.repeat(value, 2), points), np.float64)


def structure(config: KnitConfig) -> Structure:
    """Return the net of a configuration. Raises BadInput for a tube of one wale."""
    if config.form == "tube" and config.wales < 2:
        problem = "a tube of one wale would join two points twice"
        raise BadInput(problem, field="wales", value=config.wales, limit="2 at least", remedy="knit a panel")
    return Structure(config.courses, 2 * config.wales, config.form == "tube")


def knit_yarns(net: Structure, used: list[Yarn], spacing: Float) -> tuple[Springs, Yarns]:
    """Return links with their yarns' constants, and the yarns of these links; `spacing` (s,) [m]."""
    course, borrowed = net.course()
    link_yarn = course % len(used)
    rest = spacing * np.array([yarn.length for yarn in used])[link_yarn]
    k, c = np.empty(net.links), np.array([yarn.c for yarn in used])[link_yarn]
    lock, k_lock = np.empty((2, net.links)) if any(yarn.lock is not None for yarn in used) else (None, None)
    for index, yarn in enumerate(used[: net.courses]):  # further yarns than courses are not knitted
        of_yarn = link_yarn == index
        lengths, yarn_index = np.unique(rest[of_yarn], return_inverse=True)
        k[of_yarn] = np.array([yarn.stiffness(float(length)) for length in lengths])[yarn_index]
        if lock is not None and k_lock is not None:
            lock[of_yarn], k_lock[of_yarn] = np.array([yarn.locked(float(length)) for length in lengths])[yarn_index].T
    threads = net.threads()
    yarn_index = np.array([link_yarn[thread[0]] for thread in threads])
    names = tuple(dict.fromkeys(yarn.name for yarn in used))
    kind = np.array([names.index(yarn.name) for yarn in used], np.int8)[yarn_index]
    # A borrowed link has no neighbour to share tension with: mu = 0.
    alone = np.array([borrowed[thread[0]] for thread in threads])
    mu = np.where(alone, 0.0, np.array([yarn.mu for yarn in used])[yarn_index])
    ptr = np.concatenate([[0], np.cumsum([len(thread) for thread in threads])]).astype(np.int32)
    springs = Springs.from_pairs(net.pairs(), k, rest, c, lock=lock, k_lock=k_lock)
    density = np.array([yarn.density for yarn in used])[yarn_index]
    return springs, Yarns(np.concatenate(threads), ptr, mu, kind, names, density)


def place(config: KnitConfig, net: Structure) -> Float:
    """Return positions (n, 3) [m]; on a tube the spacing is the distance of neighbours, not the arc between them."""
    row, column = np.divmod(np.arange(net.points), net.columns)
    across, up = (spacing * stretch for spacing, stretch in zip(config.spacing, config.stretch, strict=True))
    x = np.zeros((net.points, 3))
    x[:, 1] = up * (row - 0.5 * net.courses)
    if config.form == "panel":
        x[:, 0] = across * (column - 0.5 * (net.columns - 1))
    else:
        radius, angle = 0.5 * across / np.sin(np.pi / net.columns), 2.0 * np.pi * column / net.columns
        # To the right as seen from outside: from +z towards +x.
        x[:, 0], x[:, 2] = radius * np.sin(angle), radius * np.cos(angle)
    x += np.asarray(config.centre)
    return x


def _pin(config: KnitConfig, net: Structure) -> Bool:
    pinned = np.zeros((net.courses + 1, net.columns), bool)
    places: dict[str, tuple[int | slice, int | slice]] = {
        "top-row": (-1, slice(None)),
        "bottom-row": (0, slice(None)),
        "left-edge": (slice(None), 0),
        "right-edge": (slice(None), -1),
    }
    for name in places if "all-rim" in config.pin else config.pin:
        if name.endswith("edge") and net.periodic:
            raise BadInput("a tube has no such edge", field="pin", value=name, limit="top-row or bottom-row")
        pinned[places[name]] = True
    return pinned.reshape(-1)
