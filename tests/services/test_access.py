"""Nobody gets in: a share of `nuno soak access`, and that its attempts succeed where nothing is guarded."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from nuno.access import folder
from nuno.access.rights import Rights
from nuno.wire.sessions import spoke
from nuno_bench.report.result import Result
from nuno_bench.soak.access import part as access
from nuno_bench.soak.access import sockets
from nuno_bench.soak.access.guarded import guarded_run
from nuno_bench.soak.access.intruders import Witness, attempt


def broken(results: list[Result]) -> list[str]:
    return [f"{r.case}: {r.failure or r.median}" for r in results if r.verdict in ("missed", "failed")]


def test_nobody_gets_in_without_the_certificate_for_it(tmp_path: Path) -> None:
    assert broken(access.attempts(tmp_path)) == []


def test_without_access_control_the_same_attempts_succeed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def none(roles: Any) -> dict[str, Any]:
        return {"enabled": False}

    monkeypatch.setattr(folder, "access_control", none)
    with guarded_run(tmp_path) as guarded, spoke(guarded.endpoint, guarded.config("observer")) as session:
        spared = Rights(asks=("finish/*",))  # the run is to be stopped by its operator
        tally = attempt(Witness(guarded, session), guarded.endpoint, guarded.config("collision"), spared)
    assert tally.read > 0 and tally.taken > 0 and tally.forged > 0


def test_only_the_hub_listens_and_only_on_loopback(tmp_path: Path) -> None:
    assert broken(sockets.measure(tmp_path, quick=True)) == []
