"""Virtual instruments against closed forms: the elastica, Peirce's length, the narrow strip's buckling, KES's loop."""

from __future__ import annotations

import math
from typing import Any

import elastica
import numpy as np
import pytest

from nuno.cli import main
from nuno.plugin_contract import registry
from nuno_bench.fabric_tests import sheet, specimens
from nuno_bench.fabric_tests.sheet import find_fabric
from nuno_bench.fabric_tests.specimens import mount
from nuno_bench.sweep.executor import Executor, Processes
from nuno_bench.validation import statics
from nuno_schemas.errors import BadInput, RunFailed

DENSITY, RIGIDITY = 0.2, 1e-5
FABRIC: dict[str, Any] = {
    "density": DENSITY, "warp": 2000.0, "weft": 2000.0, "shear": 200.0, "bend_warp": RIGIDITY, "bend_weft": RIGIDITY,
}  # fmt: skip
STEEPNESS = {1.0: 0.12456, 10.0: 1.0668, 100.0: 5.8881, 1000.0: 21.335}
"""Height over width of a heavy cantilever by w L^3 / B."""
SOLVER = registry.load("nuno.integrators", "implicit_euler")
PEIRCE = (RIGIDITY / (DENSITY * 9.81)) ** (1.0 / 3.0)


@pytest.mark.full
def test_the_elastica_is_the_published_one() -> None:
    for gamma, expected in STEEPNESS.items():
        assert elastica.steepness(gamma) == pytest.approx(expected, rel=1e-4)
    assert elastica.gamma_at(sheet.SLOPE) ** (-1.0 / 3.0) == pytest.approx(0.5, rel=1e-3)


@pytest.mark.quick(layout=["irregular"])
@pytest.mark.quick(layout=["aligned"])
@pytest.mark.parametrize("layout", ["aligned", "irregular"])
@pytest.mark.parametrize("gamma", [1.0, 10.0, pytest.param(100.0, marks=pytest.mark.full)])
def test_a_strip_hangs_as_the_elastica_does(gamma: float, layout: str) -> None:
    """Within 1 % from 24 edges a bending length on, and nearer with shorter edges."""
    length, errors = PEIRCE * gamma ** (1.0 / 3.0), []
    for share in (8, 24):
        edges = round(share * max(2.0, gamma ** (1.0 / 3.0)))
        found = sheet.steepness(*sheet.hang(FABRIC, length, edges, layout=layout))
        errors.append(abs(found / STEEPNESS[gamma] - 1.0))
    assert errors[1] < 0.01 and errors[1] < max(errors[0], 5e-3)


@pytest.mark.full
@pytest.mark.parametrize("layout", ["aligned", "irregular"])
def test_a_strip_that_hangs_almost_straight_does_too(layout: str) -> None:
    errors = [
        abs(sheet.steepness(*sheet.hang(FABRIC, 10.0 * PEIRCE, edges, layout=layout)) / STEEPNESS[1000.0] - 1.0)
        for edges in (128, 256)
    ]
    assert errors[1] < 0.01 and errors[1] < errors[0]


@pytest.mark.full
@pytest.mark.parametrize("name", ["bias", "warp", "weft"])
def test_the_cantilever_of_astm_finds_the_bending_length(name: str) -> None:
    """Of orthotropic cloth, within 1 % of Peirce's; along the bias of the rigidity that follows from both."""
    fabric = FABRIC | {"bend_warp": 2e-5}
    rigid = {"warp": 2e-5, "weft": 1e-5, "bias": 4.0 / (1 / 2e-5 + 1 / 1e-5 + 2.0 / math.sqrt(2e-10))}
    angle = {"warp": 0.0, "weft": 0.5 * math.pi, "bias": 0.25 * math.pi}
    expected = (rigid[name] / (DENSITY * 9.81)) ** (1.0 / 3.0)
    found = sheet.bending_length(sheet.overhang(fabric, 2.1 * expected, 32, angle[name]))
    assert found == pytest.approx(expected, rel=0.01)
    assert sheet.measures(fabric)["bend_bias"] == pytest.approx(rigid["bias"], rel=1e-12)


@pytest.mark.parametrize("guess", [0.3, 0.99, 1.0, 1.01, 3.0])
def test_an_overhang_is_found_where_friction_scatters_the_slope(guess: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """As of limp cloth, by 0.5 % from one length to the next, which is 0.2 % of the length."""

    def steepness(length: float, scatter: float) -> float:
        return math.tan(sheet.SLOPE) * (length / 0.02) ** 2.5 * (1.0 + scatter * math.sin(1e7 * length))

    monkeypatch.setattr(sheet, "hang", lambda fabric, length, edges, angle: (length, fabric))
    monkeypatch.setattr(sheet, "steepness", steepness)
    assert sheet.overhang(5e-3, 0.02 * guess, 32) == pytest.approx(0.02, rel=3e-3)
    assert sheet.overhang(0.0, 0.02 * guess, 32) == pytest.approx(0.02, rel=sheet.ENOUGH)
    monkeypatch.setattr(sheet, "steepness", lambda length, scatter: 0.1)
    with pytest.raises(RunFailed, match="no length is found"):
        sheet.overhang(0.0, 0.02, 32)


@pytest.mark.quick(layout=["irregular"], poisson=[0.3])
@pytest.mark.parametrize("poisson", statics.POISSON.values(), ids=statics.POISSON)
@pytest.mark.parametrize("layout", ["aligned", "crossed", "irregular"])
def test_a_narrow_strip_tips_over_as_the_closed_form_says(poisson: float, layout: str) -> None:
    found = statics.measure_buckling(SOLVER, poisson, layout)
    assert found.error <= found.allowed


@pytest.mark.full
def test_the_loop_of_kes_gives_the_sheet_back() -> None:
    """Within 2 %; what is left and lost within 1 %."""
    loop = specimens.bend(FABRIC | {"hysteresis_warp": 6e-4, "hysteresis_weft": 6e-4}, 0.25 * math.pi)
    assert loop.rigidity == pytest.approx(RIGIDITY, rel=0.02)
    assert loop.hysteresis == pytest.approx(6e-4, rel=0.02)
    assert loop.left == pytest.approx(6e-4 / (2.0 * RIGIDITY), rel=0.01)
    assert loop.work == pytest.approx(4.0 * 3e-4 * specimens.MOST, rel=0.01)
    assert loop.recovery == pytest.approx(180.0 * (1.0 - 30.0 / specimens.MOST), abs=0.2)
    elastic = specimens.bend(FABRIC, 0.25 * math.pi)
    assert abs(elastic.hysteresis) < 1e-3 * 6e-4 and abs(elastic.left) < 1e-3


@pytest.mark.parametrize("angle", [0.0, 30.0, 45.0, 90.0])
def test_tension_and_shear_are_those_of_orthotropic_cloth(angle: float) -> None:
    fabric, turn = FABRIC | {"warp": 500.0}, math.radians(angle)
    c, s = math.cos(turn) ** 2, math.sin(turn) ** 2
    warp, weft, shear = 500.0, 2000.0, 200.0
    stretch = warp * c * c + weft * s * s + 2.0 * shear * s * c + 4.0 * shear * s * c
    slide = shear * (c - s) ** 2 + (warp + weft - 2.0 * shear) * s * c
    assert specimens.stretch(fabric, turn) == pytest.approx(stretch, rel=1e-3)
    assert specimens.shear(fabric, turn) == pytest.approx(slide, rel=1e-3)


def test_a_shadow_is_the_area_and_the_folds_of_its_outline() -> None:
    """Of a flat disc with six waves of its radius."""
    angles = 2.0 * np.pi * np.arange(720) / 720
    radius = 0.12 + 0.01 * np.cos(6.0 * angles)
    rim = np.column_stack([radius * np.cos(angles), np.zeros(720), radius * np.sin(angles)])
    x = np.concatenate([rim, np.zeros((1, 3))])
    faces = np.column_stack([np.arange(720), np.roll(np.arange(720), -1), np.full(720, 720)]).astype(np.int32)
    shadow = specimens.cast_shadow(x, faces)
    assert shadow.sum() * specimens.DOT**2 == pytest.approx(np.pi * (0.12**2 + 0.5 * 0.01**2), rel=5e-3)
    assert specimens.count_nodes(shadow) == 6


def test_energy_at_rest_is_weight_times_height_and_half_the_rigidity_times_curvature_squared() -> None:
    rig, lift, curvature = mount("cantilever", FABRIC, size=[0.05, 0.05], hold=None, edge=2e-3), 0.3, 10.0
    x, weight = rig.fabric.position, 9.81 * rig.fabric.mass
    rig.state.x[:, 1] = lift
    assert rig.energy() == pytest.approx(lift * weight.sum(), rel=1e-9)
    rig.state.x[...] = specimens.roll(x, curvature)
    bent = 0.5 * RIGIDITY * curvature**2 * 0.05**2
    assert rig.energy() - weight @ rig.state.x[:, 1] == pytest.approx(bent, rel=0.02)


@pytest.mark.full
def test_a_disc_has_several_drapes_and_finds_that_of_its_start() -> None:
    """Cloth as stiff as this drapes in 4, 5 or 6 folds: as different shadows, and almost the same energy."""
    found = [specimens.drape(FABRIC, 0.015, 1, folds) for folds in (4, 5, 6)]
    assert [one.nodes for one in found] == [4, 5, 6]
    energies = [one.energy for one in found]
    assert max(energies) < 0.0 and np.ptp(energies) < 0.1 * -min(energies)
    assert np.ptp([one.coefficient for one in found]) > 0.02


@pytest.mark.full
def test_drapes_are_the_same_one_after_another_and_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sheet, "EDGES", (0.03, 0.025))
    told, rows = list[str](), list[list[sheet.SheetRow]]()
    for executor in (Executor(), Processes(2)):
        rows.append(sheet.test(FABRIC, ["drape"], sheet.TestOptions(True, executor, told.append), {}).rows)
        executor.close()
    assert rows[0] == rows[1] and len(rows[0]) == 3
    assert told[:3] == ["test 1 of 1: drape", "drape 1 of 2 is at rest", "drape 2 of 2 is at rest"]


@pytest.mark.parametrize("rigidity", [None, 1e-4])
def test_drapes_depend_on_weight_over_rigidity_alone(rigidity: float | None, monkeypatch: pytest.MonkeyPatch) -> None:
    """And a rigidity that does not follow the size is found out."""
    swatch = statics.swatch

    def cut(fabric: dict[str, float], **fields: Any) -> Any:
        return swatch(fabric=fabric | ({"bend_warp": rigidity} if rigidity else {}), **fields)

    monkeypatch.setattr(statics, "swatch", cut)
    found = statics.measure_drape(SOLVER)
    assert (found.error <= found.allowed) == (rigidity is None)


@pytest.mark.full
def test_the_command_fills_in_a_sheet(tmp_path: Any, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("fabric: {preset: denim, hysteresis_warp: 0.4 mN}\n")
    data = tmp_path / "sheet.json"
    assert main(["test", str(path), "--only", "weight,tension", "--json", str(data)]) == 0
    said = capsys.readouterr().out
    assert "ISO 3801" in said and "KES-FB1" in said and "324" in said
    assert '"hysteresis_warp": 0.0004' in data.read_text()
    assert main(["test", "denin"]) == 2
    assert "did you mean 'denim'" in capsys.readouterr().err
    assert main(["test", "denim", "--only", "tenson"]) == 2
    assert "tension" in capsys.readouterr().err
    with pytest.raises(BadInput, match="holds no `fabric`"):
        find_fabric(str(_write(tmp_path / "other.yaml", "name: x\n")))


def _write(path: Any, text: str) -> Any:
    path.write_text(text)
    return path
