"""Baths that are kept up and finite ones: closed forms of a slab, the order of exchange, and where they end."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from dye_scene import CELL, D0, write_scene
from dye_slab import CLOTH, LEFT, RED, WHOLE, slab

from nuno.dye.run import DyeRun
from nuno.dye.supply import add_up, exchange
from nuno.plugin_contract import registry
from nuno.scene import scene_file


def taken_up(t: float) -> float:
    """M_t / M_inf of a slab, one face of which is held, at t = D t / l^2 (Crank 1975, equation 4.18)."""
    orders = math.pi * (np.arange(200) + 0.5)
    return float(1.0 - np.sum(2.0 / orders**2 * np.exp(-(orders**2) * t)))


def test_a_bath_that_is_kept_up_holds_the_face_of_a_slab(tmp_path: Path) -> None:
    """The face lies in the middle of the bath's cells, half a cell before the slab's; of the second order in cells."""
    errors = []
    for cells in (11, 21):
        side = CELL * 10.5 / (cells - 0.5)
        region = LEFT | {"high": [side, 1]}
        dyeing = slab(tmp_path, cells, [WHOLE | {"region": region, "amount": 0.5}], side)
        for _ in range(4 if cells > 11 else 1):
            report = dyeing.advance().report
        phi = dyeing.state.phi[0, 0, 0]
        assert phi[0] == 0.25
        length = cells - 0.5
        share = (phi[1:].sum() + 0.5 * phi[0]) / (0.25 * length)
        steps = dyeing.frame * dyeing.steps
        errors.append(share - taken_up(0.5 * 0.25 * steps / length**2))
        given = dyeing.supplies.given[0]["supply[0] bath"]
        assert given == pytest.approx(2.0 * phi.sum(), rel=1e-13), "the account, of both layers, is what is there"
        assert dyeing.balance(report) < 1e-13
    assert abs(errors[1]) < 1e-3
    assert errors[0] / errors[1] == pytest.approx((20.5 / 10.5) ** 2, rel=0.05)


def taken_up_of_little(t: float, ratio: float) -> float:
    """M_t / M_inf of a slab in stirred liquor, `ratio` times as much of it (Crank 1975, equation 4.37)."""
    roots = []
    for n in range(1, 200):
        low, high = (n - 0.5) * math.pi, n * math.pi
        for _ in range(60):  # tan q = -ratio q has one root there; (-1)^n (sin q + ratio q cos q) rises through 0
            q = 0.5 * (low + high)
            below = (-1) ** n * (math.sin(q) + ratio * q * math.cos(q)) < 0.0
            low, high = (q, high) if below else (low, q)
        roots.append(0.5 * (low + high))
    q2 = np.array(roots) ** 2
    terms = 2.0 * ratio * (1.0 + ratio) / (1.0 + ratio + ratio**2 * q2) * np.exp(-q2 * t)
    return float(1.0 - terms.sum())


def test_a_finite_bath_is_exhausted_as_a_slab_takes_it_up(tmp_path: Path) -> None:
    """Half of the bath's cells are the slab's; a bath of L times their room is L + 1/2 cells of liquor."""
    errors = []
    for cells in (11, 21):
        side = CELL * 10.5 / (cells - 0.5)
        length, liquor = cells - 0.5, 0.8 * (cells - 0.5) - 0.5
        bath = WHOLE | {"region": LEFT | {"high": [side, 1]}, "liquor": liquor, "amount": 0.5}
        dyeing = slab(tmp_path, cells, [bath], side)
        for _ in range(4 if cells > 11 else 1):
            report = dyeing.advance().report
        phi = dyeing.state.phi[0, 0, 0]
        most = 0.25 * liquor * length / (liquor + cells)
        steps = 100 * dyeing.frame
        errors.append((phi[1:].sum() + 0.5 * phi[0]) / most - taken_up_of_little(0.125 * steps / length**2, 0.8))
        assert [entry.share for entry in dyeing.supplies.entries] == [pytest.approx(2.0 * phi[0], rel=1e-15)]
        assert dyeing.supplied[0] == pytest.approx(liquor * (0.5 - 2.0 * phi[0]), rel=1e-12)
        assert dyeing.balance(report) < 1e-12
    assert abs(errors[1]) < 1e-3
    assert errors[0] / errors[1] == pytest.approx((20.5 / 10.5) ** 2, rel=0.1)


@pytest.mark.quick(solver=["rkl2"])
@pytest.mark.parametrize("solver", sorted(registry.installed("nuno.dye_solvers")))
def test_exchange_is_of_the_first_order_in_the_step(solver: str, tmp_path: Path) -> None:
    """Held against short explicit steps. What cells hand on within a step the bath makes good only after it."""
    bath = WHOLE | {"region": LEFT, "liquor": 8.0, "amount": 0.5}

    def left(plugin: str, parts: int) -> float:
        dt = CELL**2 / (4.0 * D0) / parts
        dyeing = slab(tmp_path, 11, [bath], solver={"plugin": plugin, "dt": dt})
        dyeing.advance()
        return dyeing.supplies.entries[0].share

    exact = 2.0 * left("explicit", 64) - left("explicit", 32)
    errors = [left(solver, parts) - exact for parts in (2, 4, 8)]
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.15)
    assert errors[1] / errors[2] == pytest.approx(2.0, rel=0.1)


def test_an_automatic_step_is_short_enough_for_a_finite_bath(tmp_path: Path) -> None:
    """Others go by the solver's limit."""
    for supply, limited in ((WHOLE | {"liquor": 8.0}, True), (WHOLE, False)):
        cloth = CLOTH | {"supply": [supply]}
        scene = write_scene(tmp_path, cloth=cloth, solver="rkl2", dyes=[RED], frame_rate=1e-4, duration=1e4)
        assert (DyeRun(scene_file.read(scene), 1).dt <= CELL**2 / (2.0 * D0)) == limited


@pytest.mark.quick(solver=["rkl2"])
@pytest.mark.parametrize("solver", sorted(registry.installed("nuno.dye_solvers")))
def test_a_finite_bath_ends_at_its_share(solver: str, tmp_path: Path) -> None:
    """a L V_bath / (L V_bath + V_all): the cells that it reaches hand dye on to those that it does not."""
    dyeing = slab(tmp_path, 6, [WHOLE | {"region": LEFT, "liquor": 3.0, "amount": 0.9}],
                  solver={"plugin": solver, "dt": CELL**2 / (4.0 * D0)})  # fmt: skip
    for _ in range(30):
        dyeing.advance()
    assert [entry.share for entry in dyeing.supplies.entries] == [pytest.approx(0.9 * 3.0 / (3.0 + 6.0), rel=1e-12)]
    assert dyeing.state.phi == pytest.approx(0.15 * np.ones((1, 2, 1, 6)), rel=1e-12)


def test_what_goes_back_into_a_bath_counts_below_0_and_the_balance_is_a_share_of_what_was_given(tmp_path: Path) -> None:
    """All cells full, in fifty times as much of nearly pure water: one part in fifty-one of the dye is left."""
    bath = WHOLE | {"liquor": 50.0, "amount": 1e-9, "start": CELL**2 / D0}
    dyeing = slab(tmp_path, 6, [{"kind": "bath", "amount": 1.0}, bath])
    report = dyeing.advance().report
    (account,), (gross,), (net,) = dyeing.supplies.given, dyeing.supplies.gross, dyeing.supplied
    assert account["supply[0] bath"] == gross == pytest.approx(6.0) and account["supply[1] bath"] < 0.0
    assert net == pytest.approx(6.0 / 51.0, rel=1e-6) == report.mobile[0]
    assert dyeing.balance(report) == abs(math.fsum((report.mobile[0], report.fixed[0], -net))) / 6.0 < 1e-14


@pytest.mark.parametrize("parts", [1, 2, 4, 8])
def test_fibre_that_fixes_dye_exhausts_a_bath_further(parts: int, tmp_path: Path) -> None:
    """a L / (L + 1 + k) by the partition isotherm. What is fixed stays: where the last step took r (1 - k) of the
    share too much, r = D_ab dt / d^2, cells and bath have 1 / (L + 1) of that too little.
    """
    blue = RED | {"adsorption": 0.05, "isotherm": {"plugin": "partition", "k": 0.5}}
    bath, dt = WHOLE | {"liquor": 2.0, "amount": 0.8}, CELL**2 / (4.0 * D0) / parts
    dyeing = slab(tmp_path, 3, [bath], dyes=[blue], solver={"plugin": "explicit", "dt": dt})
    for _ in range(10):
        dyeing.advance()
    exact, rate = 0.8 * 2.0 / (2.0 + 1.0 + 0.5), 0.05 * 0.25 / parts
    assert -1e-12 <= exact - dyeing.supplies.entries[0].share <= rate * 0.5 * exact / 3.0


def test_a_finite_bath_settles_at_equal_shares_and_keeps_the_dye() -> None:
    rng = np.random.default_rng(5)
    room = rng.random(5000)
    phi, share, volume = room * rng.random(room.shape), 0.9, 3.0 * float(room.sum())
    after, left, given = exchange(phi, room, share, volume)
    assert np.allclose(after, left * room, rtol=1e-15)
    assert after.sum() - phi.sum() == pytest.approx(given, rel=1e-12)
    assert given == volume * (share - left)
    # An empty cloth takes up 1 / (L + 1) of the bath; again nothing happens.
    assert exchange(0 * phi, room, share, volume).share == pytest.approx(share * 3.0 / 4.0)
    assert exchange(after, room, left, volume).share == pytest.approx(left, rel=1e-14)
    assert exchange(phi, 0 * room, share, volume).share == share


def test_sums_are_those_of_all_numbers() -> None:
    rng = np.random.default_rng(7)
    for size in (0, 1, 1023, 1024, 1025, 10_000):
        values = rng.random(size)
        assert add_up(values) == pytest.approx(math.fsum(values), rel=1e-14)
