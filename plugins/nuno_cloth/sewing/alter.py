"""Alteration of a pattern as a cutter does it, by slash and spread, and of the edges that are sewn to what changed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from scipy.optimize import brentq

from nuno_cloth.sewing.curves import length_of
from nuno_cloth.sewing.pattern import Side, name_of
from nuno_cloth.sewing.pattern_file import SHORTEST, PanelFields, PatternFile, curve_of, require_sound, rotation_of
from nuno_schemas.errors import BadInput, nearest
from nuno_schemas.fabric import Float
from nuno_schemas.pattern import Altered
from nuno_schemas.plugin import Files
from nuno_schemas.written import Path, Written

# Let e be an edge's chord, and t the share of it at which a point of its panel lies, 0 before its start and 1 beyond
# its end. Every corner and control point moves by g t e: the panel is slashed across the edge and spread. Points keep
# their t, so that the former length takes it back. Along e, s goes to s + g t(s), which increases with s while g > -1:
# straight outlines neither cross nor turn over, and curves seldom do. Arcs of circles keep their angle. Rejected: their
# depth, by which one that is shortened to nothing becomes a circle, and their radius, which soon does not reach.
#
# What is sewn to an edge gets the same ratio of lengths. Where both are equal, that is the same difference; gathered
# cloth keeps its fullness everywhere, which the same difference would change. It is slashed where the other one was: t
# then goes from 0 to 1 as along that. Else only half of a shirt would keep its sleeves, as its front is lengthened.

Points = NDArray[np.complex128]
"""Points x + i y of a drawing, in the file's unit: a relative control point is a complex share of the chord."""
LONGEST = 10.0
"""Longest length that an edge is altered to [m]."""
EASED = 1e-4
"""Difference along a seam that no scissors cut [m]."""
ALONG = np.linspace(0.0, 1.0, 1025)
"""Shares of an edge, from its start, between which its gain is linear."""
DIGITS = 12
"""Decimals of altered numbers; a smaller change is none."""
LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


def alter_pattern(files: Files, name: str, side: Side, length: float) -> Altered:
    """Return a pattern's file with an edge `length` [m] long. Raises BadInput for a pattern that cannot be sewn, an
    edge that it does not have, and a length with which it cannot be sewn.
    """
    written = files.read(name, PatternFile)
    cut = _Cut(written)
    if side not in cut.former:
        remedy = nearest(name_of(side), map(name_of, cut.former))
        raise BadInput("the pattern has no such edge", name, value=name_of(side), remedy=remedy)
    try:
        altered, eased = cut.alter(side, length)
    except BadInput as error:
        limit = error.limit or f"{100 * cut.former[side]:.4g} cm, as it is, can be sewn"
        problem = f"{name_of(side)} cannot get this length: {error.problem}"
        raise BadInput(problem, field="length", value=f"{100 * length:.6g} cm", limit=limit) from None
    text = files.resolve(name).read_bytes().decode("utf-8-sig")
    return Altered(_rewrite(text, _differing(written.said.model_dump(), altered.model_dump()), name), eased)


class _Cut:
    """A pattern's panels while they are altered."""

    def __init__(self, written: Written[PatternFile]) -> None:
        self.written, self.pattern = written, require_sound(written)
        self.unit, self.coords = 1.0 / written.said.properties.units_in_meter, written.said.properties.curvature_coords
        panels = self.pattern.panels.items()
        self.former = {(name, k): edge.length for name, panel in panels for k, edge in enumerate(panel.edges)}
        self.shares: dict[str, Callable[[Points], Float]] = {}

    def alter(self, picked: Side, length: float) -> tuple[PatternFile, tuple[str, ...]]:
        """Return the file with an edge of this length [m], and the seams that are eased. Raises BadInput.

        From panel to panel, edges follow those that they are sewn to, each once, unless that would move more away from
        what has been settled than it settles.
        """
        if not 0.0 < length <= LONGEST:
            raise BadInput("too short or too long", limit=f"more than 0, up to {LONGEST:g} m")
        said, partner = self.written.said, self.pattern.partner
        self.panels = dict(said.pattern.panels)
        self._spread(picked, length, ALONG)
        settled, changed = [picked], [picked[0]]
        for panel in changed:
            for side in sorted((one for one in partner if one[0] == panel), key=lambda one: one != picked):
                (other, right_wrong), off, before = partner[side], self._off(side), (self.panels, self.shares)
                if other in settled or abs(self._length(side) - self.former[side]) < EASED:
                    continue
                settled += [side, other]
                if abs(off) > EASED:
                    least, gain = sum(abs(self._off(one)) for one in settled), self._gain(side)
                    self._spread(other, self._length(other) + off, gain if right_wrong else 1.0 - gain[::-1])
                    now, exact = sum(abs(self._off(one)) for one in settled), abs(self._length(picked) - length) < 1e-10
                    if now < least and exact:
                        changed.append(other[0])
                    else:
                        self.panels, self.shares = before
        altered = said.model_copy(update={"pattern": said.pattern.model_copy(update={"panels": self.panels})})
        require_sound(replace(self.written, said=altered))
        seams = [(seam.names, 1e3 * abs(self._off(seam.one))) for seam in self.pattern.seams]
        return altered, tuple(f"{names}: {by:.1f} mm" for names, by in seams if by > 1e3 * EASED)

    def _length(self, side: Side, panel: PanelFields | None = None) -> float:
        fields = panel or self.panels[side[0]]
        edge = fields.edges[side[1]]
        start, end = (self.unit * np.array(fields.vertices[k]) for k in edge.endpoints)
        return length_of(curve_of(edge, start, end, self.unit, self.coords))

    def _off(self, side: Side) -> float:
        """Return how much longer what an edge is sewn to has to be for the former ratio [m], 0 for a free edge."""
        other, _ = self.pattern.partner.get(side, (side, False))
        return self._length(side) * self.former[other] / self.former[side] - self._length(other)

    def _gain(self, side: Side) -> Float:
        """Return the share of a changed edge's gain that lies before points ALONG it."""
        share = self.shares[side[0]](_complex(self.pattern.edge(side).curve.at(ALONG) / self.unit))
        whole = share[-1] - share[0]
        return np.maximum.accumulate(np.clip((share - share[0]) / whole, 0.0, 1.0)) if whole else ALONG

    def _spread(self, side: Side, length: float, gain: Float) -> None:
        """Spread an edge's panel until the edge has a length [m]; `gain` is the share of the growth before each point
        ALONG it. The end that is placed higher stays there, and both move alike where they are level. Raises BadInput.
        """
        fields = self.panels[side[0]]
        start, end = _complex([fields.vertices[k] for k in fields.edges[side[1]].endpoints])
        chord = end - start

        def share(points: Points) -> Float:
            return np.asarray(np.interp(((points - start) / chord).real, ALONG, gain))

        def spread(g: float) -> PanelFields:
            return self._move(fields, lambda points: points + g * share(points) * chord)

        def excess(g: float) -> float:
            return self._length(side, spread(g)) - length

        shortest = SHORTEST / self.unit / abs(chord) - 1.0
        if (over := excess(shortest)) > 0.0:
            limit = f"{name_of(side)} is at least {100 * (length + over):.4g} cm long"
            raise BadInput("its ends meet before it is so short", limit=limit)
        # No curve is shorter than its chord.
        g = brentq(excess, shortest, max(length / self.unit / abs(chord) - 1.0, 0.0) + 1.0, xtol=1e-14, rtol=1e-14)
        panel = spread(g)
        if "translation" in fields.model_fields_set:
            way = rotation_of(*np.radians(fields.rotation))[:, :2] @ [chord.real, chord.imag]
            place = np.array(fields.translation) - 0.5 * (1.0 + way[1] / abs(chord)) * g * way
            panel = panel.model_copy(update={"translation": tuple(place.tolist())})
        self.panels, self.shares = self.panels | {side[0]: panel}, self.shares | {side[0]: share}

    def _move(self, fields: PanelFields, move: Callable[[Points], Points]) -> PanelFields:
        """Return the fields of a panel whose points move."""
        corners, edges = _complex(fields.vertices), []
        after = move(corners)
        for edge in fields.edges:
            (start, end), (to_start, to_end) = corners[list(edge.endpoints)], after[list(edge.endpoints)]
            curvature: Any = edge.curvature
            params: Any = curvature and curvature.params
            if curvature and curvature.type == "circle":
                half, ratio = 0.5 * abs(to_end - to_start), params[0] / (0.5 * abs(end - start))
                # The length of a half circle hangs on the last digit of its radius, unless that does not quite reach.
                params = (float(half * (ratio if ratio > 1.0 + 1e-9 else 1.0 - 1e-10)), *params[1:])
            elif curvature and self.coords == "absolute":
                params = _pairs(move(_complex(params)))
            elif curvature:
                params = _pairs((move(start + _complex(params) * (end - start)) - to_start) / (to_end - to_start))
            curvature = curvature and curvature.model_copy(update={"params": params})
            edges.append(edge.model_copy(update={"curvature": curvature}))
        return fields.model_copy(update={"vertices": _pairs(after), "edges": tuple(edges)})


def _complex(points: Any) -> Points:
    return np.asarray(np.asarray(points) @ [1.0, 1.0j])


def _pairs(points: Points) -> tuple[tuple[float, float], ...]:
    return tuple((float(one.real), float(one.imag)) for one in points)


def _differing(one: Any, other: Any, path: Path = ()) -> Iterator[tuple[Path, float]]:
    """Yield the paths of numbers that differ, and the other's."""
    if isinstance(one, dict | tuple):
        for part in one if isinstance(one, dict) else range(len(one)):
            yield from _differing(one[part], other[part], (*path, part))
    elif one != other and abs(one - other) > 10.0**-DIGITS:
        yield path, round(other, DIGITS)


def _rewrite(text: str, numbers: Iterator[tuple[Path, float]], name: str) -> str:
    """Return a YAML or JSON text with other numbers; all else stays, comments too. Raises BadInput for a number that
    may stand for several panels.
    """
    plain = text.replace("\t", " ")  # YAML has no tabs, and JSON has them only between values
    if any(isinstance(event, yaml.AliasEvent) for event in yaml.parse(plain, LOADER)):
        remedy = "write out what stands for *names"
        raise BadInput("a number of it may belong to several panels, by an alias of YAML", name, remedy=remedy)
    root, places = yaml.compose(plain, LOADER), list[tuple[int, int, str]]()
    for path, number in numbers:
        node: Any = root
        for part in path:
            if isinstance(node, yaml.MappingNode):
                node = next(value for key, value in node.value if key.value == part)
            elif part != "params":
                node = node.value[part]
            else:  # files of 2021 have one control point alone
                node = yaml.SequenceNode("", [node])
        written = repr(number) if "." in repr(number) else repr(number).replace("e", ".0e")  # as YAML's floats
        places.append((node.start_mark.index, node.end_mark.index, written))
    for start, end, written in sorted(places, reverse=True):
        text = text[:start] + written + text[end:]
    return text
