"""Columns over the frames of a recording: what the services reported of each."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno.recording.reader import Recording
from nuno_schemas.messages import DYE_STATUS, PENETRATION, STATUSES

FIELDS = ("frame", "t", "steps", "step_seconds", "stretch", "time", "balance")
"""Of a status; only those that it has."""
OWN = ("steps", "step_seconds")
"""Of each service; of the dye of a garment as dye_steps, dye_step_seconds."""
TABLES = ("energy", "wrinkles", "mobile", "fixed", "supplied")
"""Mappings in a status: each entry is a column, `energy_kinetic`."""


def read_series(recording: Recording) -> dict[str, NDArray[Any]]:
    """frame, t [s], steps, step_seconds, energy_* [J], stretch, and from the collision service depth [m],
    inside, mean [m]; of a cloth that is dyed mobile_*, fixed_* and supplied_* by dye, balance, and time, that of
    the dyeing [s]; NaN where one is missing.
    """
    rows: dict[int, dict[str, Any]] = {}
    for message in recording.messages(STATUSES):
        value = recording.json(message.payload)
        own = "dye_" if message.topic == DYE_STATUS.name and not recording.dyed_alone else ""
        row = {own + name if name in OWN else name: value[name] for name in FIELDS if name in value}
        for name in TABLES:
            table = value.get(name)
            row |= {f"{name}_{key}": number for key, number in table.items()} if isinstance(table, dict) else {}
        rows.setdefault(recording.whole(value.get("frame", -1)), {}).update(row)
    for message in recording.messages([PENETRATION.name]):
        value = recording.json(message.payload)
        rows.setdefault(
            recording.whole(value.get("frame", -1)), {"frame": value.get("frame"), "t": value.get("t")}
        ).update({name: value.get(name) for name in ("depth", "inside", "mean")})
    names = list(dict.fromkeys(name for row in rows.values() for name in row))
    return {name: _column([rows[frame].get(name) for frame in sorted(rows)]) for name in names}


def _column(values: list[Any]) -> NDArray[Any]:
    """Whole numbers where all are, else float64 with NaN for what is missing."""
    if all(isinstance(value, int) for value in values):
        return np.array(values, np.int64)
    return np.array([np.nan if value is None else value for value in values], np.float64)
