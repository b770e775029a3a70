"""Yarns to knit with, in physical units, each with its source.

A yarn's tensile stiffness is EA [N], force per strain: its specific modulus [N/tex] times its linear density. A
link of rest length L then has k = EA / L, so that a finer net of the same yarn stretches the same.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from pydantic import Field, field_validator, model_validator

from nuno_knit.quantities import LinearDensity, Newtons, Ratio, Share, SpringDamping, Stiffness
from nuno_schemas.plugin import Config
from nuno_schemas.preset import Measure, Preset

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


def list_yarns() -> tuple[Preset, ...]:
    """Return every preset, in units of scenes."""
    return tuple(_preset(name, preset) for name, preset in PRESETS.items())


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
