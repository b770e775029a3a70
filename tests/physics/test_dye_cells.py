"""A cloth from arrays: taken exactly as they are, or refused by name before anything is computed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dye_reference import random_cells
from pydantic import ValidationError

from nuno_dye.cloths.cells import CellsCloth, CellsConfig
from nuno_dye.laws.isotherms import FreundlichConfig, LangmuirConfig, PartitionConfig
from nuno_schemas.dye import Tortuosity
from nuno_schemas.errors import BadInput

TAU3 = {"I": 0.5, "II": 0.05, "III": 0.1, "IV": 1, "V": 0.9}


class Folder:
    """Files as a scene resolves them."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def resolve(self, name: str) -> Path:
        return self.path / name


def arrays(ny: int = 5, nx: int = 7) -> dict[str, Any]:
    cells = random_cells(ny, nx)
    return {
        "fibre": cells.fibre, "up": cells.up, "porosity": cells.porosity, "tau1": cells.twist,
        "resist": 0.2 * np.ones(cells.fibre.shape), "phi": 0.5 * cells.mobile_room, "fixed": 0.1 * cells.fixed_room,
    }  # fmt: skip


def build(folder: Path, data: dict[str, Any], dyes: int = 1, **fields: Any) -> Any:
    np.savez(folder / "cells.npz", **data)
    config = CellsConfig.model_validate(
        {"file": "cells.npz", "cell_size": "0.05 mm", "tau2": 0.47, "tau3": TAU3, **fields}
    )
    return CellsCloth().build(config, Folder(folder), 0, [f"dye{k}" for k in range(dyes)])


def test_arrays_are_taken_as_they_are(tmp_path: Path) -> None:
    data = arrays()
    cells, state = build(tmp_path, data)
    assert cells.size == pytest.approx(5e-5, rel=1e-15)
    assert cells.tortuosity == Tortuosity(layers=0.5, beside=0.05, rim=0.1, gap=1.0, yarn=0.9, weave=0.47)
    taken = (cells.fibre, cells.up, cells.porosity, cells.twist, cells.resist)
    for name, array in zip(("fibre", "up", "porosity", "tau1", "resist"), taken, strict=True):
        assert np.array_equal(array, data[name])
    assert np.array_equal(state.phi[0], data["phi"]) and np.array_equal(state.fixed[0], data["fixed"])


def test_a_full_cell_may_be_computed_in_another_order(tmp_path: Path) -> None:
    data = arrays()
    data["phi"] = (1.0 - data["resist"]) * (data["porosity"] * 3.0)
    cells, state = build(tmp_path, data, v_max=3)
    assert (state.phi[0] <= cells.mobile_room).all()


def test_several_dyes_have_amounts_of_their_own(tmp_path: Path) -> None:
    data = arrays()
    data |= {name: np.stack([data[name], 0.5 * data[name]]) for name in ("phi", "fixed")}
    _, state = build(tmp_path, data, 2)
    assert np.array_equal(state.phi, data["phi"])
    with pytest.raises(BadInput) as refused:
        build(tmp_path, data, 3)
    assert "(2, 2, 5, 7)" in str(refused.value) and "(3, 2, 5, 7)" in str(refused.value)


@pytest.mark.parametrize("name", ["porosity", "tau1", "resist", "phi", "fixed"])
@pytest.mark.parametrize("value", [-0.01, 1.01, np.nan, np.inf])
def test_numbers_out_of_range_are_refused_by_name(name: str, value: float, tmp_path: Path) -> None:
    data = arrays()
    data[name] = data[name].copy()
    data[name][1, 2, 3] = value
    with pytest.raises(BadInput) as refused:
        build(tmp_path, data)
    assert refused.value.field == f"{name}[1, 2, 3]" and refused.value.file == str(tmp_path / "cells.npz")


def test_a_gap_holds_no_fixed_dye(tmp_path: Path) -> None:
    data = arrays()
    index = tuple(int(i) for i in np.argwhere(~data["fibre"])[0])
    data["fixed"][index] = 1e-6
    with pytest.raises(BadInput, match="more dye than the cell can hold") as refused:
        build(tmp_path, data)
    assert refused.value.field == f"fixed[{', '.join(map(str, index))}]"


@pytest.mark.parametrize("name", ["up", "porosity", "tau1", "resist", "phi", "fixed"])
def test_shapes_that_differ_are_both_named(name: str, tmp_path: Path) -> None:
    data = arrays()
    data[name] = data[name][:, :, :-1]
    with pytest.raises(BadInput) as refused:
        build(tmp_path, data)
    assert refused.value.field == name and "(2, 5, 6)" in str(refused.value) and "(2, 5, 7)" in str(refused.value)


def test_files_that_lie_are_refused(tmp_path: Path) -> None:
    data = arrays()
    without = {name: array for name, array in data.items() if name != "tau1"}
    flat = {name: array[0] for name, array in data.items()}
    cases = {"missing": without, "unknown array": data | {"tua1": data["tau1"]}, "wrong shape": flat,
             "wrong dtype": data | {"fibre": data["porosity"]}}  # fmt: skip
    for words, case in cases.items():
        with pytest.raises(BadInput, match=words):
            build(tmp_path, case)
    (tmp_path / "cells.npz").write_bytes(b"no archive")
    config = CellsConfig.model_validate({"file": "cells.npz", "cell_size": 1, "tau3": TAU3})
    with pytest.raises(BadInput, match="not a readable"):
        CellsCloth().count(config, Folder(tmp_path))


@pytest.mark.parametrize(
    ("config", "fields"),
    [
        (FreundlichConfig, {"k": 1, "b": 0.09}),
        (FreundlichConfig, {"k": 1, "b": 1.01}),
        (PartitionConfig, {"k": -1}),
        (LangmuirConfig, {"K": -1}),
        (LangmuirConfig, {"K": 1, "k": 1}),
        (CellsConfig, {"file": "a", "cell_size": "1 mm", "tau3": TAU3 | {"V": 1.1}}),
        (CellsConfig, {"file": "a", "cell_size": "1 mm", "tau3": TAU3, "tau2": -0.1}),
        (CellsConfig, {"file": "a", "cell_size": "0 mm", "tau3": TAU3}),
    ],
)
def test_configurations_out_of_range_are_refused(config: Any, fields: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        config.model_validate(fields)
