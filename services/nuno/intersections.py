"""What is said of cloth that passes through cloth or bodies, and of how near it comes to cloth: in reports, of
recordings, at the end.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from nuno.formatting import many
from nuno.recording.reader import Recording
from nuno_schemas.messages import PENETRATION

MOST_SPELLS = 20
"""Of a recording that are shown to a person."""


def passing(found: Mapping[str, Any]) -> str:
    """Which object passes through which, and where [m]."""
    one, other = found["objects"]
    place = ", ".join(f"{value:.4g}" for value in found["place"])
    return f"{one} through {'itself' if one == other else other} at [{place}] m"


def problem(found: Mapping[str, Any] | None) -> str:
    """What is wrong with a run by what the collision service found of its cloth; empty where nothing is."""
    if found is None or not (first := found["first_crossing"]):
        return ""
    where = f"first in frame {first['frame']} ({first['t']:.4g} s), {passing(first)}"
    return f"crossed: cloth passes through {_what(found)} in {many(found['crossed'], 'frame')}, {where}"


def rows(found: Mapping[str, Any] | None) -> list[tuple[str, str]]:
    """The same as rows of a report."""
    if found is None:
        return []
    text = f"cloth passes through {_what(found)} in {found['crossed']:,} of {many(found['looked'], 'frame')}"
    if found["allowed"]:
        text += f", but for {', '.join(map(_both, found['allowed']))}, which may"
    if first := found["first_crossing"]:
        text += f", up to {many(found['crossings'], 'edge')} through triangles in one, first in frame {first['frame']}"
        return [("crossings", f"{text} ({first['t']:.4g} s), {passing(first)}")]
    if not found["thickness"]:
        return [("crossings", text)]
    thick, least = _millimetres(found["thickness"]), found["least_distance"]
    if least is None:
        return [("crossings", text), ("distance", f"cloth is never nearer to cloth than {thick}, its thickness")]
    near = f"cloth is pressed to within {_millimetres(least)} of cloth; it pushes back from {thick} on, its thickness"
    return [("crossings", text), ("distance", near)]


def _both(pair: Sequence[str]) -> str:
    """Two objects in words, which may be one."""
    return f"{pair[0]} and {'itself' if pair[0] == pair[1] else pair[1]}"


def find_spells(recording: Recording) -> list[dict[str, Any]]:
    """When cloth passes through cloth in a recording: first and last `frames` of each spell of frames, `t` [s] of both,
    the most `crossings` in one, and the first `place` [m] with the `objects` of edge and triangle.
    """
    spells: list[dict[str, Any]] = []
    for message in recording.messages([PENETRATION.name]):
        value = recording.said(message)
        number, frame = value.get("crossings") or 0, value["frame"]
        if not number or not (value["places"] and value["objects"]):
            continue
        if not spells or spells[-1]["frames"][1] != frame - 1:
            where = {"place": value["places"][0], "objects": value["objects"][0]}
            spells.append({"frames": [frame, frame], "t": [message.t] * 2, "crossings": 0} | where)
        spell = spells[-1]
        spell["frames"][1], spell["t"][1] = frame, message.t
        spell["crossings"] = max(spell["crossings"], number)
    return spells


def find_nearest(recording: Recording) -> dict[str, Any] | None:
    """The least `distance` [m] of cloth from cloth in a recording, its `frame` and `t` [s]; None for none."""
    values = ((message.t, recording.said(message)) for message in recording.messages([PENETRATION.name]))
    found = [(value["distance"], value.get("frame"), t) for t, value in values if value.get("distance") is not None]
    return dict(zip(("distance", "frame", "t"), min(found), strict=True)) if found else None


def spell_rows(spells: list[dict[str, Any]], nearest: Mapping[str, Any] | None) -> list[tuple[str, str]]:
    """What `nuno info` shows of these."""
    lines = []
    for spell in spells[:MOST_SPELLS]:
        (first, last), (start, end) = spell["frames"], spell["t"]
        when = (
            f"frame {first}, {start:.4g} s"
            if first == last
            else f"frames {first} to {last}, {start:.4g} to {end:.4g} s"
        )
        edges = f"up to {many(spell['crossings'], 'edge')} through triangles"
        lines.append(("crossings", f"{when}: {passing(spell)}; {edges}"))
    if len(spells) > MOST_SPELLS:
        lines.append(("", f"and {len(spells) - MOST_SPELLS:,} times more"))
    if nearest and nearest["distance"] > 0.0:
        text = f"{_millimetres(nearest['distance'])}, in frame {nearest['frame']} ({nearest['t']:.4g} s)"
        lines.append(("cloth nearest to cloth", text))
    return lines


def _what(found: Mapping[str, Any]) -> str:
    """What cloth is not to pass through."""
    return " or ".join(["cloth", *found.get("bodies", ())])


def _millimetres(distance: float) -> str:
    return f"{1e3 * distance:.3g} mm"
