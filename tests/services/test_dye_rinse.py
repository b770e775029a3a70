"""Rinsing: mobile dye is taken away at a time, fixed dye stays, and the account says how much went."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dye_scene import CELL, D0, TAU3, arrays, write_scene

import nuno
from nuno.dye.run import DyeRun
from nuno.plugin_contract import registry
from nuno.replay.verification import verify
from nuno.runtime import supervisor
from nuno.runtime.service import Options
from nuno.scene import scene_file

BLUE = {"name": "blue", "D0": D0, "adsorption": 0.5, "isotherm": {"plugin": "langmuir", "K": 2.0}}
RED = {"name": "red", "D0": D0}
FRAME = 1.8
LEFT = {"shape": "rectangle", "low": [0, 0], "high": [5 * CELL, 1]}


def scene(folder: Path, supply: list[dict[str, Any]], **fields: Any) -> Path:
    """Two dyes on cells of all kinds, of which blue is fixed by fibre."""
    data = arrays()
    data |= {name: np.stack([data[name], 0.5 * data[name]]) for name in ("phi", "fixed")}
    cloth = {"plugin": "cells", "file": "cells.npz", "cell_size": CELL, "tau3": TAU3, "supply": supply}
    return write_scene(folder, data=data, cloth=cloth, dyes=[BLUE, RED], **fields)


@pytest.mark.quick(solver=["explicit"])
@pytest.mark.parametrize("solver", sorted(registry.installed("nuno.dye_solvers")))
def test_a_rinse_leaves_no_mobile_dye_and_all_that_fibre_holds(solver: str, tmp_path: Path) -> None:
    """To the last bit: without mobile dye fibre takes none, so what it holds is what it held before the rinse."""
    rinse = {"kind": "rinse", "start": 3 * FRAME}
    dyeing = DyeRun(scene_file.read(scene(tmp_path, [rinse], solver={"plugin": solver, "dt": FRAME})), 1)
    for _ in range(3):
        before = dyeing.advance().report
    fixed = dyeing.state.fixed.copy()
    assert (fixed[0].sum(), min(before.mobile)) > (1.0, 1.0)
    for _ in range(3):
        report = dyeing.advance().report
        assert not dyeing.state.phi.any() and np.array_equal(dyeing.state.fixed, fixed)
        assert dyeing.balance(report) < 1e-14
    for account, mobile in zip(dyeing.supplies.given, before.mobile, strict=True):
        assert account["supply[0] rinse"] == pytest.approx(-mobile, rel=1e-14)


def test_a_rinse_takes_its_share_of_one_dye_where_it_is(tmp_path: Path) -> None:
    """Of dyes that do not spread, so that nothing else changes them. At 0 it acts once, too."""
    still = [BLUE | {"D0": 0.0}, RED | {"D0": 0.0}]
    rinses = [
        {"kind": "rinse", "dye": "blue", "region": LEFT, "share": 0.25},
        {"kind": "rinse", "layers": "warp", "start": FRAME, "share": 0.5},
    ]
    bare = DyeRun(scene_file.read(scene(tmp_path, [])), 1).state.phi
    dyeing = DyeRun(scene_file.read(scene(tmp_path, rinses), [f"dye.dyes={still}"]), 1)
    expected = bare.copy()
    expected[0, :, :, :5] *= 0.75
    dyeing.advance()
    assert np.array_equal(dyeing.state.phi, expected)
    expected[:, 1] *= 0.5
    for _ in range(2):
        report = dyeing.advance().report
        assert np.array_equal(dyeing.state.phi, expected)
    taken = [math.fsum(account[name] for name in account if "rinse" in name) for account in dyeing.supplies.given]
    assert taken == [pytest.approx(amounts.sum(), rel=1e-14) for amounts in expected - bare]
    assert dyeing.balance(report) < 1e-14


def test_baths_with_a_rinse_between_are_resumed_and_replayed_to_the_last_bit(tmp_path: Path) -> None:
    """Overdyeing, with the rinse half-way through the second frame; and from a checkpoint after it."""
    recipe = [
        {"kind": "bath", "dye": "blue", "maintained": True, "stop": 1.5 * FRAME, "amount": 0.5},
        {"kind": "rinse", "start": 1.5 * FRAME, "share": 0.75},
        {"kind": "bath", "dye": "red", "maintained": True, "start": 2 * FRAME, "amount": 0.5},
    ]
    path = scene(tmp_path, recipe, duration=6 * FRAME, solver={"plugin": "explicit", "dt": FRAME / 2})
    whole = nuno.run(path, record=tmp_path / "whole.mcap")
    assert verify(whole.recording).frame is None
    nuno.run(path, f"duration={4 * FRAME}", record=tmp_path / "part.mcap")
    options = Options(record=tmp_path / "resumed.mcap", resume=tmp_path / "part.mcap")
    resumed = supervisor.supervise(scene_file.read(path), options)
    assert resumed.summary["digest"] == whole.digest
    dye = whole.report["dye"]
    assert resumed.summary["dye"]["given"] == dye["given"] and dye["balance"] < 1e-13
    assert dye["given"]["blue"]["supply[1] rinse"] < 0.0 < dye["given"]["blue"]["supply[0] bath"]
    for name, account in dye["given"].items():
        assert dye["supplied"][name] == pytest.approx(math.fsum(account.values()), rel=1e-14)
