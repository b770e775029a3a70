"""Presets of dyes. The diffusion coefficient follows from the molar mass; most other values are assumed, and marked so.

D0       3.6 sqrt(76 / M) mm^2/h, M in g/mol (dye paper, equation 5), unless measured.
isotherm its measured kind, if any: indigo on silk follows Langmuir (Kongkachuichay et al., Chiang Mai Journal of
         Science 37(2), 2010, 363-367), madder on wool Nernst and Temkin (Chemchame et al., International Journal of
         Chemical Sciences 19(1), 2021, 306). Amounts here are shares of a cell's capacity, so that constants from a
         laboratory, in grams per litre, cannot be used: all constants are chosen.
colour   chosen by eye from dyed cloth, without a colour standard.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from nuno_schemas.preset import Measure, Preset

MM2_PER_HOUR = 1e-6 / 3600.0
"""[m^2/s]."""


@dataclass(frozen=True)
class KnownDye:
    """A dye preset: fields of the scene's dye, in SI; fibre and mordant they apply to; the origin `how` of each of
    these: `measured`, or `derived` or `assumed`, a colon and the reason; source; molar mass of the colourant [g/mol].
    """

    fields: Mapping[str, Any]
    fibre: str
    mordant: str
    how: Mapping[str, str]
    source: str
    mass: float | None = None


def spread(mass: float) -> float:
    """Return the diffusion coefficient in water [m^2/s] of a dye of this molar mass [g/mol]."""
    return 3.6 * math.sqrt(76.0 / mass) * MM2_PER_HOUR


def _natural(
    colourant: str, mass: float, fibre: str, mordant: str, source: str, isotherm: Mapping[str, Any], kind: str,
    colour: Mapping[str, str] | None = None,
) -> KnownDye:  # fmt: skip
    fields: dict[str, Any] = {"D0": spread(mass), "adsorption": 0.01, "isotherm": isotherm}
    how = {
        "D0": f"derived: 3.6 sqrt(76 / M) mm^2/h of {colourant}, M = {mass:g} g/mol",
        "adsorption": "assumed: as of the dye paper's figure 9",
        "isotherm": f"assumed: {kind}; its constant is chosen",
        "fibre": "assumed: a fibre that is dyed so",
        "mordant": "assumed: as is customary",
    }
    if colour is not None:
        fields["colour"], how["colour"] = colour, "assumed: by eye"
    return KnownDye(fields, fibre, mordant, how, source, mass)


_PARTITION = {"plugin": "partition", "k": 0.5}
_MADDER = {"light": "#f7eeee", "mid": "#d0605a", "dark": "#7a1518"}
_WELD = {"light": "#f6f4e4", "mid": "#e8c94a", "dark": "#c08a10"}
_WALNUT = {"light": "#f5f0ea", "mid": "#a87c50", "dark": "#46290f"}

PRESETS: dict[str, KnownDye] = {
    "indigo": _natural(
        "indigotin", 262.26, "silk", "none, from a vat",
        "kind of isotherm: Kongkachuichay et al., Chiang Mai Journal of Science 37(2), 2010, 363-367",
        {"plugin": "langmuir", "K": 5.0}, "Langmuir, as measured on silk",
    ),
    "madder": _natural(
        "alizarin", 240.21, "wool", "alum",
        "kind of isotherm: Chemchame et al., International Journal of Chemical Sciences 19(1), 2021, 306",
        _PARTITION, "partition, which with Temkin's was measured to fit on wool", _MADDER,
    ),
    "weld": _natural("luteolin", 286.24, "wool", "alum", "no measurement", _PARTITION, "as of madder", _WELD),
    "walnut": _natural("juglone", 174.15, "wool", "none", "no measurement", _PARTITION, "as of madder", _WALNUT),
    "dye-paper": KnownDye(
        {"D0": 1.93 * MM2_PER_HOUR, "adsorption": 0.01, "isotherm": _PARTITION}, "not said", "not said",
        {
            "D0": "assumed: of table 1, for which 264 g/mol would do",
            "adsorption": "assumed: of table 1, figure 9",
            "isotherm": "assumed: of figure 9(a); its constant is not printed, and chosen",
            "fibre": "assumed: not said",
            "mordant": "assumed: not said",
        },
        "the dye of the dye paper's figures, which it does not name",
    ),
}  # fmt: skip
"""A preset without a colour has the default colour of a scene's dye."""


def written_out(name: str, own: Mapping[str, Any]) -> dict[str, Any]:
    """Return a dye's fields as in a scene: those of the preset, replaced by those in `own`, also within the colour."""
    fields = {"name": name, **PRESETS[name].fields, **own}
    colour, changed = PRESETS[name].fields.get("colour"), own.get("colour")
    if isinstance(colour, Mapping) and isinstance(changed, Mapping):
        fields["colour"] = {**colour, **changed}
    return fields


def list_dyes() -> tuple[Preset, ...]:
    """Return every preset, in units of scenes, with the constants of its isotherm by name."""
    return tuple(_preset(name, known) for name, known in PRESETS.items())


def _preset(name: str, known: KnownDye) -> Preset:
    isotherm = known.fields["isotherm"]
    measures = (
        Measure("M", "g/mol", known.mass),
        Measure("D0", "mm^2/h", known.fields["D0"] / MM2_PER_HOUR),
        Measure("adsorption", "", known.fields["adsorption"]),
        *(Measure(constant, "", isotherm.get(constant)) for constant in ("k", "K")),
    )
    source = f"{isotherm['plugin']}; fibre: {known.fibre}; mordant: {known.mordant}; {known.source}"
    return Preset(name, source, measures, known.how)
