"""The sparse factorisation of an implicit step's matrix, and what exact solutions bring to Newton's method."""

from __future__ import annotations

import numpy as np
import pytest
from implicit_nets import DOWN, PLUGINS, dense, sheet
from nets import make_fabric, make_system, start

import nuno_integrators.packing
from nuno_integrators.implicit.conjugate import multiply
from nuno_integrators.implicit.factor import factorise, make_factor, solve_factored
from nuno_integrators.implicit.matrix import fill, make_linear
from nuno_integrators.implicit.newton import keep_positive, turning_work
from nuno_integrators.implicit.plan import dissect, make_plan
from nuno_integrators.implicit.plugin import TRBDF2, ImplicitEuler
from nuno_integrators.packing import pack, to_rows
from nuno_schemas.fabric import Hinges, Springs


def tangle(seed, n=90, far=False):
    """Springs and hinges between vertices at random, in two pieces, with a spring of no length and pinned vertices."""
    rng = np.random.default_rng(seed)
    x = rng.standard_normal((n, 3))
    half = n // 2
    pairs = [rng.choice(half, 2, replace=False) + half * (s % 2) for s in range(4 * n)]
    if not far:
        pairs = [pair for pair in pairs if abs(pair[0] - pair[1]) < 8]
    x[7] = x[5]
    pairs = np.array([*pairs, (5, 7)], np.int32)
    quads = np.array([rng.choice(half, 4, replace=False) for _ in range(n // 3)], np.int32)
    one = np.ones(len(quads), np.int32)
    hinges = Hinges(quads, one, one, rng.uniform(0.0, 1e-2, len(quads)), np.zeros(len(quads)))
    rest = 0.8 * np.linalg.norm(x[pairs[:, 0]] - x[pairs[:, 1]], axis=1)
    springs = Springs.from_pairs(pairs, rng.uniform(10.0, 1e3, len(pairs)), rest, np.full(len(pairs), 0.1))
    pinned = rng.uniform(size=n) < 0.1
    return make_fabric(x, springs, hinges, 2e-3, pinned)


FABRICS = {
    "runs": lambda: sheet(13),
    "lists": lambda: sheet(13, shuffle=True),
    "hinges": lambda: sheet(12, bend=1e-2),
    "near": lambda: tangle(1),
    "far": lambda: tangle(2, far=True),
    "nothing coupled": lambda: make_fabric(np.random.default_rng(1).standard_normal((50, 3))),
}


@pytest.mark.quick(build=[FABRICS["hinges"], FABRICS["far"]])
@pytest.mark.parametrize("build", FABRICS.values(), ids=FABRICS)
def test_the_factor_gives_the_dense_solution(build, monkeypatch):
    monkeypatch.setattr("nuno_kernels.step.blocks.SMALL", 0)
    fabric = build()
    n, rng = fabric.number, np.random.default_rng(0)
    packed, x = pack(make_system(fabric)), to_rows(fabric.position)
    linear = make_linear(packed)
    linear.own[:3] = fabric.mass / 0.01**2
    linear.own[3:] = 0.1 * linear.own[0] * rng.uniform(-1.0, 1.0, (3, n))
    fill(x * 1.01, 100.0, packed, linear)
    free = np.tile(~fabric.pinned, 3)
    a = dense(linear, n)[np.ix_(free, free)]
    factor = make_factor(make_plan(fabric.position, linear), n)
    for _ in range(2):
        assert factorise(factor, linear)
        r, found = rng.standard_normal((3, n)) * ~fabric.pinned, np.full((3, n), np.nan)
        solve_factored(factor, r, found)
        expected = np.linalg.solve(a, r.ravel()[free])
        np.testing.assert_allclose(found.ravel()[free], expected, atol=1e-12 * np.abs(expected).max())
        assert not found[:, fabric.pinned].any()


def test_a_matrix_that_is_not_positive_is_said_to_be():
    fabric = sheet(9)
    packed = pack(make_system(fabric))
    linear = make_linear(packed)
    factor = make_factor(make_plan(fabric.position, linear), 81)
    linear.own[:3] = 1e-6
    for exact, positive in ((True, False), (False, True)):
        fill(0.9 * to_rows(fabric.position), 100.0, packed, linear, exact)
        assert factorise(factor, linear) == positive
    linear.own[0, 40] = np.nan
    assert not factorise(factor, linear)


def test_an_ordered_sheet_fills_in_as_dissection_promises():
    """Entries grow as n log n from 32 x 32 to 64 x 64, 4.8 times; those of a band would grow 8 times."""
    entries = []
    for side in (32, 64):
        fabric = sheet(side)
        entries.append(make_plan(fabric.position, make_linear(pack(make_system(fabric)))).entries)
    assert entries[1] / entries[0] < 5.5


def test_halves_are_not_coupled():
    """Every edge of a random graph leads to a vertex's own node or to one above it."""
    rng = np.random.default_rng(4)
    position = rng.standard_normal((300, 3))
    edges = np.unique(np.sort(rng.integers(0, 300, (500, 2)), axis=1), axis=0)
    edges = edges[edges[:, 0] != edges[:, 1]]
    tree = dissect(position, edges)
    assert np.array_equal(np.sort(np.concatenate(tree.vertices)), np.arange(300))
    node = np.empty(300, int)
    for number, vertices in enumerate(tree.vertices):
        node[vertices] = number
    for i, j in node[edges]:
        low, high = min(i, j), max(i, j)
        while low != high and low >= 0:
            low = tree.parent[low]
        assert low == high


def spring(x1, k=50.0, rest=0.9):
    """One vertex on a spring from a pinned one at the origin."""
    springs = Springs.from_pairs(np.array([[0, 1]], np.int32), np.array([k]), np.array([rest]), np.zeros(1))
    return make_fabric(np.array([[0.0, 0.0, 0.0], x1]), springs, pinned=np.array([True, False]))


def test_a_spring_that_turned_is_as_stiff_across_as_a_linear_step_expects():
    """From (1, 0, 0) to (1, 0.5, 0): its share along the old direction is still 1, whatever its length is now."""
    fabric, k, rest = spring((1.0, 0.5, 0.0)), 50.0, 0.9
    packed = pack(make_system(fabric))
    linear, x, before = make_linear(packed), to_rows(fabric.position), np.array([[0.0, 1.0], [0.0, 0.0], [0.0, 0.0]])
    across = np.array([[0.0, 0.0], [0.0, 0.0], [0.0, 1.0]])
    fill(x, 1.0, packed, linear, False, before)
    length = np.hypot(1.0, 0.5)
    assert multiply(linear, across, None)[2, 1] == pytest.approx(k * (1.0 - rest) / length, rel=1e-12)
    fill(x, 1.0, packed, linear, False)
    assert multiply(linear, across, None)[2, 1] == pytest.approx(k * (length - rest) / length, rel=1e-12)
    work = turning_work(before, x, x - before, packed)
    assert work == pytest.approx(k * (length - 1.0) * 0.25 / length, rel=1e-12)
    assert turning_work(before, 1.3 * before, 0.3 * before, packed) == 0.0


@pytest.mark.parametrize(
    "values", [(3, 2, 1), (3, 2, -1), (1, 1, -2), (-1, -2, -3), (5, 0, 0), (1e9, -1e-3, 2.0), (0, 0, 0)]
)
def test_the_positive_part_has_the_positive_eigenvalues(values):
    turn = np.linalg.qr(np.random.default_rng(6).standard_normal((3, 3)))[0]
    values = np.array(values, float)
    a, expected = ((turn * part) @ turn.T for part in (values, np.maximum(values, 0.0)))
    a = 0.5 * (a + a.T)
    keep_positive(a, np.empty((3, 3)), np.empty(3))
    np.testing.assert_allclose(a, expected, atol=1e-14 * max(1.0, np.abs(values).max()))


@pytest.mark.parametrize(("plugin", "growth"), [(ImplicitEuler(), 24), (TRBDF2(), 6)], ids=["euler", "tr_bdf2"])
def test_newton_steps_grow_little_with_stiffness(plugin, growth):
    """A level sheet falls for a third of a second, a frame a step, with 1e2 and 1e8 N/m: with loose solutions and
    the tension of the moment Newton's method takes 80 (implicit Euler) and 25 times the steps, 80 times the
    iterations each.
    """
    newton, iterations = [], []
    for k in (1e2, 1e8):
        system = make_system(sheet(16, k=k), DOWN)
        state = start(system)
        memory = plugin.prepare(plugin.Config(), system, state)
        reports = [plugin.advance(system, state, memory, None, 1, 1.0 / 60.0) for _ in range(20)]
        assert all(report.status == "ok" for report in reports)
        totals = {name: sum(report.totals[name] for report in reports) for name in reports[0].totals}
        newton.append(totals["newton_steps"])
        iterations.append(totals["linear_iterations"] / totals["newton_steps"])
    assert newton[1] < growth * newton[0]
    assert iterations[1] < 2 * iterations[0]


@PLUGINS
@pytest.mark.full
def test_factorisations_give_equal_bytes_for_any_number_of_threads(plugin, monkeypatch):
    monkeypatch.setattr(nuno_integrators.packing, "PARALLEL_FROM", 0)
    ends = []
    for threads in (1, 2):
        system = make_system(sheet(24, k=1e7), DOWN, 0.1, threads=threads)
        state = start(system)
        memory = plugin.prepare(plugin.Config(), system, state)
        report = plugin.advance(system, state, memory, None, 3, 1.0 / 60.0)
        assert report.totals["factorisations"] > 0
        ends.append(state.x.tobytes() + state.v.tobytes())
    assert ends[0] == ends[1]
