"""Nobody gets in: the part `access` of `make soak`, and that its attempts succeed where nothing is guarded."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import nuno
from nuno.bus import credentials_folder
from nuno.bus.credentials_folder import PEOPLE, Rights
from nuno_schemas.errors import BadInput, RunFailed
from soak import access


def test_nobody_gets_in_without_the_certificate_for_it() -> None:
    results = access.run(quick=True, seed=0)
    assert [f"{r.case}: {r.failure or r.median}" for r in results if r.verdict in ("missed", "failed")] == []
    assert len(results) >= 15


@pytest.mark.full
def test_without_access_control_the_same_attempts_succeed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def none(roles: Any) -> dict[str, Any]:
        return {"enabled": False}

    monkeypatch.setattr(credentials_folder, "access_control", none)
    with access.guarded_run(tmp_path) as guarded:
        spared = Rights(asks=("finish/*",))  # the run is to be stopped by its operator
        # The hub waits for the run's services alone: to an observer that lags it may drop what was forged.
        tries = (access.attempt(guarded, guarded.endpoint, guarded.config("collision"), spared) for _ in range(5))
        got = any(one is not None and min(one) > 0 for one in tries)
    assert got, "messages read, requests taken, forgeries delivered"


@pytest.mark.full
def test_a_run_is_heard_by_observers_and_its_bodies_are_operators(tmp_path: Path) -> None:
    """From another host, where nothing but the certificate says who one is."""
    with access.guarded_run(tmp_path) as guarded:
        run, endpoint, (operator, observer) = guarded.run, guarded.endpoint, map(guarded.config, PEOPLE)
        with nuno.watch(run, "sim/status", connect=endpoint, config=observer) as heard:
            assert next(heard).value.state == "running"
        with pytest.raises(BadInput, match=r"ball has no motion: {plugin: topic}"):
            nuno.drive(run, "ball", connect=endpoint, config=operator)
        with pytest.raises(RunFailed, match="an operator's certificate"):
            nuno.drive(run, "ball", connect=endpoint, config=observer)
        with pytest.raises(BadInput, match="no such run"):
            nuno.watch("other", connect=endpoint, config=observer)
        guarded.stop()
