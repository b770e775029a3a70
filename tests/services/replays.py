"""Recordings of a sheet that waves, and what the page of the studio asks for to replay them, for tests."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from live_run import wait_until
from numpy.typing import NDArray
from recorded_sheet import Sheet, items, metadata
from studio_desk import ask

from nuno.bus.encodings import encode_points
from nuno.recording.reader import END
from nuno.recording.writer import RecordingWriter
from nuno.studio.desk import Desk
from nuno_schemas.messages import FABRIC, STATE

FOLDER = Path("recordings")


def unpack(answer: tuple[str, bytes]) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Head and arrays of what the server tells, as the page takes them apart."""
    body = answer[1]
    size = int.from_bytes(body[:4], "little")
    head, at = json.loads(body[4 : 4 + size]), 4 + size
    arrays = {}
    for name, kind, count in head["arrays"]:
        arrays[name] = np.frombuffer(body, kind, count, at)
        at += 4 * count
    assert at == len(body)
    return head, arrays


def frames(desk: Desk, film: str, first: int, count: int, beside: str = "") -> tuple[dict[str, Any], dict[str, Any]]:
    query = {"film": [film], "first": [str(first)], "count": [str(count)], "beside": [beside]}
    return unpack(desk.screen.frames(query))


def both(desk: Desk, one: str, two: str) -> tuple[list[str], dict[str, Any]]:
    """The films of two recordings, and how far apart they are once all is measured."""
    films = [ask(desk, "replay", recording=name)["film"] for name in (one, two)]
    wait_until(lambda: ask(desk, "compare", first=films[0], second=films[1])["measured"])
    return films, ask(desk, "compare", first=films[0], second=films[1])


def waving(
    path: Path, rate: float = 50.0, size: float = 1.0, sheet: Sheet | None = None, frames: int = 20, at: float = 0.0,
    begin: float = 0.0, told: bool = True,
) -> None:  # fmt: skip
    """A sheet that waves `size` times as far, recorded at a rate from a time [s] on, `at` [m] along x; whether the
    recording tells what its cloth is.
    """
    sheet = sheet or Sheet()
    writer = RecordingWriter(path, metadata(), {})
    for topic, header, payload in items(sheet, frames):
        t = header.t * 50.0 / rate
        if topic == STATE.name:
            payload = encode_points(sheet.rest + size * (sheet.x(t) - sheet.rest) + [at, 0.0, 0.0], t)
        if (topic == STATE.name and t < begin) or (topic == FABRIC.name and not told):
            continue
        writer.write(topic, header.model_copy(update={"t": t}), payload)
    writer.finish({END: {"state": "done", "complete": "true", "missing": "{}"}})
