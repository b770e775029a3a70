"""A session that has no part in a run, and what it can send."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import zenoh
from live_run import Run

import nuno

DEEP = b"[" * 100_000


def key(run: Run, topic: str) -> str:
    return f"nuno/{run.run}/{topic}"


def put(session: zenoh.Session, run: Run, topic: str, payload: bytes | str, attachment: bytes | str | None) -> None:
    """Publish as a foreigner; never dropped on the way, so that every message can be counted."""
    congestion = zenoh.CongestionControl.BLOCK
    session.put(key(run, topic), payload, attachment=attachment, congestion_control=congestion)


def settle(session: zenoh.Session, run: Run) -> None:
    """Wait until what was published has arrived: a question and its answer pass behind it."""
    replies(session, key(run, "control"), b'{"action": "status"}')


def replies(session: zenoh.Session, key: str, payload: bytes | None) -> list[str]:
    """Text of every answer to a question, good or bad."""
    found = session.get(key, payload=payload, timeout=20.0)
    return [(r.ok or r.err).payload.to_bytes().decode(errors="replace") for r in found]


def header(run: str, **changed: Any) -> str:
    good = {"run": run, "service": "simulation", "seq": 10**6, "frame": 7, "t": 0.1}
    return json.dumps(good | changed)


def session_answer(session: zenoh.Session, key: str, payload: bytes) -> bytes:
    reply = next(iter(session.get(key, payload=payload, timeout=20.0)))
    assert reply.ok is not None
    return bytes(reply.ok.payload.to_bytes())


def undisturbed(folder: Path, frames: int) -> nuno.Result:
    """The same scene left alone, ending at the same frame."""
    return nuno.run(folder / "scene.yaml", f"duration={frames / 50}", record=folder / "quiet.mcap")
