"""Ikat: dye on the yarns of one system alone, by a pattern along and across them, each off along itself."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dye_runs import SOLVERS
from pattern_files import Folder, write_image
from pydantic import TypeAdapter, ValidationError

from nuno_dye.cloths.woven_cloth import Ikat, WovenCloth, WovenClothConfig
from nuno_dye.laws.isotherms import Langmuir
from nuno_schemas.dye import Cells, Dye, DyeState, DyeSystem
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float

BANDS = {"pattern": "bands", "period": "1 mm", "width": "0.4 mm"}
PITCH = {"warp": 6, "weft": 5}
"""Cells."""
CLOTH = {
    "cells": [120, 100], "cell_size": "0.05 mm", "tau3": {"I": 0.1, "II": 0.1, "III": 0.1},
    "warp": {"width": 4, "gap": 2}, "weft": {"width": 3, "gap": 2, "porosity": 0.7},
}  # fmt: skip


def build(
    root: Path, *ikat: dict[str, Any], dyes: tuple[str, ...] = ("blue",), seed: int = 3
) -> tuple[Cells, DyeState]:
    config = WovenClothConfig.model_validate(CLOTH | {"ikat": ikat})
    return WovenCloth().build(config, Folder(root), seed, dyes)


def lines(root: Path, yarns: str, seed: int = 3, **item: Any) -> Float:
    """(n, m) the share of V_d that each of a system's yarns holds, along it."""
    cells, state = build(root, {"yarns": yarns, "amount": 1} | item, seed=seed)
    layer = 1 if yarns == "warp" else 0
    share = state.fixed[0, layer] / np.where(cells.fibre[layer], cells.fixed_room[layer], 1.0)
    share = (share.T if layer else share).reshape(-1, PITCH[yarns], 100 if layer else 120)
    fibre = share[:, 1:-1]  # between half gaps of a cell
    assert (fibre == fibre[:, :1]).all(), "a yarn is dyed through"
    assert not share[:, 0].any() and not share[:, -1].any(), "and gaps are not"
    return np.asarray(fibre[:, 0])


@pytest.mark.parametrize("yarns", ["warp", "weft"])
def test_ikat_dyes_one_system_s_yarns_alone_and_as_much_of_them_as_is_said(yarns: str, tmp_path: Path) -> None:
    item = {"yarns": yarns, "pattern": BANDS, "amount": 0.5, "loose": 0.25, "dye": "blue"}
    cells, state = build(tmp_path, item, dyes=("red", "blue"))
    layer = 1 if yarns == "warp" else 0
    for amounts, share, room in ((state.fixed, 0.5, cells.fixed_room), (state.phi, 0.25, cells.mobile_room)):
        assert not amounts[0].any() and not amounts[1, 1 - layer].any()
        assert amounts[1, layer].sum() == pytest.approx(0.4 * share * room[layer][cells.fibre[layer]].sum(), rel=1e-12)


@pytest.mark.parametrize("yarns", ["warp", "weft"])
def test_each_yarn_is_off_along_itself_by_what_its_seed_says(yarns: str, tmp_path: Path) -> None:
    """Bands are as wide and as far apart as before; a yarn's own lie up to `shift` from the others'."""
    even = lines(tmp_path, yarns, pattern=BANDS)
    assert (even == even[0]).all() and (even[0] == (np.arange(even.shape[1]) % 20 < 8)).all()
    shifted = lines(tmp_path, yarns, pattern=BANDS, shift="0.2 mm")
    found = [next(k for k in range(-10, 10) if (np.roll(even[0], k) == line).all()) for line in shifted]
    assert min(found) < -1 and max(found) > 1 and max(map(abs, found)) <= 4
    assert np.array_equal(shifted, lines(tmp_path, yarns, pattern=BANDS, shift="0.2 mm"))
    assert not np.array_equal(shifted, lines(tmp_path, yarns, pattern=BANDS, shift="0.2 mm", seed=4))


def test_patterns_go_along_and_across_yarns(tmp_path: Path) -> None:
    """Lozenges cover half of the cloth; bands that lean are later on each further yarn, by tan of the angle."""
    lozenges = lines(tmp_path, "warp", pattern={"pattern": "diamonds", "along": "5 mm", "across": "3 mm"})
    assert lozenges.mean() == pytest.approx(0.5, abs=0.02)
    assert np.array_equal(lozenges, lozenges[::-1]) and np.array_equal(lozenges, lozenges[:, ::-1])
    leaning = lines(tmp_path, "warp", pattern=BANDS | {"angle": -np.arctan(2 / 3)})
    for k, line in enumerate(leaning):
        assert np.array_equal(line, np.roll(leaning[0], 4 * k)), "6 cells further on, 4 cells later"


def test_an_image_dyes_where_it_is_black(tmp_path: Path) -> None:
    """Read at each yarn's middle; a shift of a yarn moves what lies on it, by shares of cells too."""
    values = np.random.default_rng(1).random((100, 120))
    write_image(tmp_path / "a.png", values)
    image = {"pattern": "image", "file": "a.png"}
    assert np.abs(lines(tmp_path, "warp", pattern=image) - (1.0 - values[:, 3::6].T)).max() < 2e-5
    assert np.abs(lines(tmp_path, "weft", pattern=image) - (1.0 - values[2::5])).max() < 2e-5
    ramp = np.linspace(0.0, 1.0, 100)
    write_image(tmp_path / "a.png", np.tile(ramp[:, None], 120))
    off = 99.0 * (lines(tmp_path, "warp", pattern=image, shift="0.2 mm") - (1.0 - ramp))[:, 10:-10]
    assert np.ptp(off, axis=1).max() < 5e-3, "a yarn is off by the same all along"
    assert off.min() < -2.0 and off.max() > 2.0 and np.abs(off).max() < 4.01


@pytest.mark.parametrize("name", SOLVERS)
def test_what_was_dyed_before_weaving_does_not_run(name: str, tmp_path: Path) -> None:
    """To the last bit, beside another dye's loose dye that does."""
    items = ({"pattern": BANDS, "amount": 0.5}, {"pattern": BANDS, "dye": "red", "amount": 0, "loose": 0.5})
    cells, state = build(tmp_path, *items, dyes=("blue", "red"))
    law = Langmuir().prepare(Langmuir.Config(K=0.1))
    dyes = tuple(Dye(name, 5e-10, 0.5, law) for name in ("blue", "red"))
    system, before = DyeSystem(cells, dyes), (state.fixed.copy(), state.phi.copy())
    plugin, config, _ = SOLVERS[name]
    memory = plugin.prepare(config, system, state)
    assert plugin.advance(system, state, memory, 5, 1.0).status == "ok"
    assert np.array_equal(state.fixed[0], before[0][0]) and not state.phi[0].any()
    assert (state.phi[1] != before[1][1]).any() and state.fixed[1].any()


def test_what_is_no_ikat_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=r"(?s)ikat\[1\].dye.*did you mean 'blue'"):
        build(tmp_path, {"pattern": BANDS}, {"pattern": BANDS, "dye": "bleu"})
    for item, words in (({"pattern": BANDS, "yarns": "both"}, "'warp' or 'weft'"), ({}, "pattern"),
                        ({"pattern": BANDS, "shift": -1.0}, "greater than or equal to 0")):  # fmt: skip
        with pytest.raises(ValidationError, match=words):
            TypeAdapter(Ikat).validate_python(item)
