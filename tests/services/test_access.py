"""Nobody gets in: the part `access` of `make soak`, and that its attempts succeed where nothing is guarded."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from nuno.access import folder
from nuno.access.rights import Rights
from soak import access


def test_nobody_gets_in_without_the_certificate_for_it() -> None:
    results = access.run(quick=True, seed=0)
    assert [f"{r.case}: {r.failure or r.median}" for r in results if r.verdict in ("missed", "failed")] == []
    assert len(results) >= 15


def test_without_access_control_the_same_attempts_succeed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def none(roles: Any) -> dict[str, Any]:
        return {"enabled": False}

    monkeypatch.setattr(folder, "access_control", none)
    with access.guarded_run(tmp_path) as guarded:
        spared = Rights(asks=("finish/*",))  # the run is to be stopped by its operator
        # The hub waits for the run's services alone: to an observer that lags it may drop what was forged.
        tries = (access.attempt(guarded, guarded.endpoint, guarded.config("collision"), spared) for _ in range(5))
        got = any(one is not None and min(one) > 0 for one in tries)
    assert got, "messages read, requests taken, forgeries delivered"
