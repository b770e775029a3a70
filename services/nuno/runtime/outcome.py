"""The outcome of a run: its state at the end, and its problem and crossings in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from nuno.formatting import many
from nuno.process import SIGNALS
from nuno.recording.reader import Recording
from nuno.recording.writer import part_of
from nuno.runtime.launch import Plan
from nuno_schemas.errors import BadInput
from nuno_schemas.messages import PENETRATION


@dataclass
class Outcome:
    """State of a run at its end, and the reports of its services."""

    run: str
    state: str
    """done, stopped, interrupted, terminated, diverged, unconverged or failed"""
    error: str
    plan: Plan
    summary: dict[str, Any]
    services: dict[str, dict[str, Any]] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)

    @property
    def problem(self) -> str:
        """The problem of the run in words; empty if there is none."""
        if self.state in ("done", "stopped"):
            return problem(self.services.get("collision", {}).get("cloth_contact"))
        if self.state in SIGNALS:
            return f"{self.state} by {SIGNALS[self.state]} before its end"
        return f"{self.state}: {self.error or self.summary.get('message') or 'positions are no longer finite'}"

    def recording(self, target: Path) -> Path | None:
        """Return the run's recording, finished or not, as the recorder names it or at `target`; None if it is at
        neither: the recorder may be on another host.
        """
        file = self.services.get("recorder", {}).get("file")
        for path in (*([Path(file)] if file else []), part_of(target), target):
            with suppress(BadInput), Recording(path, scan=False) as recording:
                if recording.metadata["run"].get("id") == self.run:
                    return path
        return None


# Texts about crossings of cloth with cloth or bodies, and the least distance of cloth from cloth, for reports and
# recordings.

MOST_SPELLS = 20
"""Most shown spells of a recording."""


def passing(crossing: Mapping[str, Any]) -> str:
    """Return which object passes through which, and where [m], in words."""
    one, other = crossing["objects"]
    place = ", ".join(f"{value:.4g}" for value in crossing["place"])
    return f"{one} through {'itself' if one == other else other} at [{place}] m"


def problem(results: Mapping[str, Any] | None) -> str:
    """Return the problem of a run by the collision service's results; empty without crossings."""
    if results is None or not (first := results["first_crossing"]):
        return ""
    where = f"first in frame {first['frame']} ({first['t']:.4g} s), {passing(first)}"
    return f"crossed: cloth passes through {_obstacles(results)} in {many(results['crossed'], 'frame')}, {where}"


def rows(facts: Mapping[str, Any] | None) -> list[tuple[str, str]]:
    """Return the collision service's results as rows of a report."""
    if facts is None:
        return []
    text = f"cloth passes through {_obstacles(facts)} in {facts['crossed']:,} of {many(facts['looked'], 'frame')}"
    if facts["allowed"]:
        text += f", but for {', '.join(map(_both, facts['allowed']))}, which may"
    if first := facts["first_crossing"]:
        text += f", up to {many(facts['crossings'], 'edge')} through triangles in one, first in frame {first['frame']}"
        return [("crossings", f"{text} ({first['t']:.4g} s), {passing(first)}")]
    if not facts["thickness"]:
        return [("crossings", text)]
    thick, least = _millimetres(facts["thickness"]), facts["least_distance"]
    if least is None:
        return [("crossings", text), ("distance", f"cloth is never nearer to cloth than {thick}, its thickness")]
    near = f"cloth is pressed to within {_millimetres(least)} of cloth; it pushes back from {thick} on, its thickness"
    return [("crossings", text), ("distance", near)]


def _both(pair: Sequence[str]) -> str:
    """Return two objects, or one and itself, in words."""
    return f"{pair[0]} and {'itself' if pair[0] == pair[1] else pair[1]}"


def find_spells(recording: Recording) -> list[dict[str, Any]]:
    """Find spells of crossings in a recording: first and last `frames` of each, `t` [s] of both, the most `crossings`
    in one frame, and the first `place` [m] with the `objects` of edge and triangle.
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
    """Return the least `distance` [m] of cloth from cloth in a recording, its `frame` and `t` [s]; None for none."""
    values = ((message.t, recording.said(message)) for message in recording.messages([PENETRATION.name]))
    distances = [(value["distance"], value.get("frame"), t) for t, value in values if value.get("distance") is not None]
    return dict(zip(("distance", "frame", "t"), min(distances), strict=True)) if distances else None


def spell_rows(spells: list[dict[str, Any]], nearest: Mapping[str, Any] | None) -> list[tuple[str, str]]:
    """Return spells and the least distance as rows of `nuno info`."""
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


def _obstacles(results: Mapping[str, Any]) -> str:
    """Return the objects of the cloth contact in words."""
    return " or ".join(["cloth", *results.get("bodies", ())])


def _millimetres(distance: float) -> str:
    return f"{1e3 * distance:.3g} mm"
