"""Implicit methods: the residual they promise, their matrix and its factorisation, steps that only they take."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from contact_world import G, contact_for, geometry, move, plane
from implicit_nets import DOWN, PLUGINS, dense, sheet
from nets import make_fabric, make_system, start

import nuno_integrators.packing
from nuno_integrators.explicit.adaptive import Dop853
from nuno_integrators.implicit import newton
from nuno_integrators.implicit.conjugate import multiply, solve
from nuno_integrators.implicit.factor import factorise, make_factor, solve_factored
from nuno_integrators.implicit.matrix import fill, make_linear
from nuno_integrators.implicit.newton import keep_positive, turning_work
from nuno_integrators.implicit.plan import dissect, make_plan
from nuno_integrators.implicit.plugin import TRBDF2, ImplicitEuler
from nuno_integrators.packing import pack, to_rows
from nuno_kernels.step.acceleration import evaluate
from nuno_schemas.bodies import Poses
from nuno_schemas.fabric import Hinges, Springs
from nuno_schemas.system import Term


@pytest.mark.quick(plugin=["tr_bdf2"])
@PLUGINS
def test_converges_to_the_solution_of_another_method(plugin):
    """A sheet that swings and folds, with damping: the error falls at the stated order."""
    system = make_system(sheet(5, k=60.0, ratio=0.1), DOWN, 0.5)
    exact = start(system)
    memory = Dop853().prepare(Dop853.Config(tolerance=1e-11), system, exact)
    assert Dop853().advance(system, exact, memory, None, 1, 0.25).status == "ok"
    errors, counts = [], np.array([1600, 3200, 6400] if plugin.order == 1 else [100, 200, 400, 800])
    for count in counts:
        state = start(system)
        memory = plugin.prepare(plugin.Config(residual=1e-9), system, state)
        assert plugin.advance(system, state, memory, None, int(count), 0.25 / count).status == "ok"
        errors.append(np.abs(state.x - exact.x).max())
    order = -np.polyfit(np.log(counts), np.log(errors), 1)[0]
    assert abs(order - plugin.order) < 0.1


@PLUGINS
@pytest.mark.parametrize("k", [1e2, 1e4, 1e6, 1e8])
def test_no_stiffness_is_too_much_for_a_frame_as_a_step(plugin, k):
    """The limit of an explicit step at k = 1e8 is 20,000 times smaller. Implicit Euler never gains energy."""
    system = make_system(sheet(12, k=k), DOWN)
    state = start(system)
    memory = plugin.prepare(plugin.Config(), system, state)
    energy = []
    for _ in range(30):
        report = plugin.advance(system, state, memory, None, 1, 1.0 / 60.0)
        assert report.status == "ok"
        assert report.steps >= 1
        energy.append(sum(report.energy.values()))
    gained = np.diff(energy).max() / (system.fabric.mass.sum() * G)
    assert gained < (1e-6 if plugin.order == 1 else 1e-2)
    assert state.x[:, 1].min() < -0.3, "it fell"
    assert report.stretch < max(0.02, 40.0 / k)


def test_the_residual_is_what_was_promised():
    """Recomputed here from Newton's second law: m (v' - v) / h - f(x', v')."""
    system, h = make_system(sheet(8), DOWN, 0.3), 0.01
    state, plugin = start(system), ImplicitEuler()
    memory = plugin.prepare(plugin.Config(residual=1e-6), system, state)
    for _ in range(10):
        v = state.v.copy()
        assert plugin.advance(system, state, memory, None, 1, h).status == "ok"
        a = np.empty((3, 64))
        evaluate(to_rows(state.x), to_rows(state.v), 0.0, a, pack(system))
        free = ~system.fabric.pinned
        missing = system.fabric.mass[:, None] * (a.T - (state.v - v) / h)
        springs = system.fabric.springs
        d = state.x[springs.pairs()[:, 0]] - state.x[springs.pairs()[:, 1]]
        largest = np.abs(springs.k * (np.linalg.norm(d, axis=1) - springs.rest)).max()
        assert np.linalg.norm(missing[free], axis=1).max() < 1.01e-6 * largest


def on_plane(alpha, mu, k=1e5, mass=1e-2):
    """A vertex on an incline that falls along +x, at its rest depth."""
    contact = contact_for(geometry(plane(), friction=mu), np.array([mass]), k)
    move(contact, 1.0)
    gravity = G * np.array([np.sin(alpha), -np.cos(alpha), 0.0])
    fabric = make_fabric(np.array([[0.0, -mass * G * np.cos(alpha) / k, 0.0]]), mass=mass)
    return make_system(fabric, gravity, terms=(Term("contact", (contact,)),))


STILL = Poses(0.0, np.array([[1.0, 0.0, 0.0, 0.0]]), np.zeros((1, 3)))
POSES = STILL, replace(STILL, t=1.0)


@PLUGINS
@pytest.mark.full
@pytest.mark.parametrize("share", [0.9, 1.2])
def test_an_incline_holds_or_lets_go_as_coulomb_says(plugin, share):
    mu = 0.4
    alpha = np.arctan(share * mu)
    system = on_plane(alpha, mu)
    state = start(system)
    memory = plugin.prepare(plugin.Config(residual=1e-8), system, state)
    places = []
    for _ in range(2):
        assert plugin.advance(system, state, memory, POSES, 200, 1.0 / 400).status == "ok"
        places.append(state.x[0, 0])
    if share < 1.0:
        assert places[0] < 1e-4, "it gives way once, because it is let go at once"
        assert abs(places[1] - places[0]) < 1e-12
    else:
        # Implicit Euler falls h v / 2 further: its velocity is the one at the step's end.
        expected = 0.5 * G * (np.sin(alpha) - mu * np.cos(alpha))
        assert state.x[0, 0] == pytest.approx(expected, rel=0.01)
        assert state.v[0, 0] == pytest.approx(2.0 * expected, rel=0.005)
    assert state.x[0, 1] == pytest.approx(-1e-2 * G * np.cos(alpha) / 1e5, rel=1e-4)


@PLUGINS
@pytest.mark.full
def test_any_number_of_threads_gives_equal_bytes(plugin, monkeypatch):
    monkeypatch.setattr(nuno_integrators.packing, "PARALLEL_FROM", 0)
    ends = []
    for threads in (1, 2):
        system = make_system(sheet(50, bend=1e-5), DOWN, 0.1, threads=threads)
        state = start(system)
        memory = plugin.prepare(plugin.Config(), system, state)
        assert (memory.work.packed.threads is None) == (threads == 1)
        assert plugin.advance(system, state, memory, None, 3, 0.01).status == "ok"
        ends.append(state.x.tobytes() + state.v.tobytes())
    assert ends[0] == ends[1]


@PLUGINS
def test_a_force_in_python_is_part_of_the_solve(plugin):
    """A drag of 1e4 1/s over steps of 10 ms: the speed is the closed form's limit, gravity over drag."""

    def drag(x, v, t, out):
        out -= 1e4 * 1e-3 * v

    system = make_system(make_fabric(np.zeros((1, 3))), DOWN, terms=(Term("python", drag),))
    state = start(system)
    memory = plugin.prepare(plugin.Config(residual=1e-9), system, state)
    assert plugin.advance(system, state, memory, None, 20, 0.01).status == "ok"
    assert state.v[0, 1] == pytest.approx(-G / 1e4, rel=1e-6)


@PLUGINS
def test_what_does_not_converge_is_said_with_its_residual(plugin):
    """A force that points away from where it would have to be has no solution at any step."""

    def jump(x, v, t, out):
        out[:, 0] += np.where(v[:, 0] > 0.0, -1e9, 1e9)

    system = make_system(make_fabric(np.zeros((1, 3))), terms=(Term("python", jump),))
    state = start(system)
    memory = plugin.prepare(plugin.Config(most_iterations=5), system, state)
    report = plugin.advance(system, state, memory, None, 1, 0.01)
    assert report.status == "unconverged"
    assert "residual of" in report.message
    assert np.isfinite(state.x).all()


def line(n, k, ends):
    """n vertices of 1 g along x, 0.1 m apart at rest, squeezed to two thirds; the first, or both ends, are pinned."""
    x = np.zeros((n, 3))
    x[:, 0] = np.arange(n) * 0.1 * 2.0 / 3.0
    at, one = np.arange(n, dtype=np.int32), np.ones(n - 1)
    springs = Springs.from_pairs(np.stack([at[:-1], at[1:]], 1), k * one, 0.1 * one, 0.0 * one)
    return make_fabric(x, springs, mass=1e-3, pinned=(at == 0) | (ends & (at == n - 1)))


def squeezed_sheet(k):
    """Squeezed to two thirds along x, undamped, springs in any order."""
    fabric = sheet(6, k=k, ratio=0.0, shuffle=True)
    return replace(fabric, position=fabric.position * [2.0 / 3.0, 1.0, 1.0])


SQUEEZED = {
    "5, one end": line(5, 4e6, False),
    "5, both ends": line(5, 4e6, True),
    "31, one end": line(31, 4e6, False),
    "31, both ends": line(31, 4e6, True),
    "sheet": squeezed_sheet(4e6),
}


@pytest.mark.quick(residual=[1e-9])
@PLUGINS
@pytest.mark.parametrize("net", SQUEEZED)
@pytest.mark.parametrize("residual", [1e-6, 1e-9])
def test_stiff_springs_pressed_together_straight_give_way(plugin, net, residual):
    """An unstable balance, which weight alone disturbs: a spring pushes with 133 kN, a vertex weighs 10 mN.

    What was stored is gone in ten frames as steps: what swings that fast is damped, and no implicit step gains energy.
    """
    system = make_system(SQUEEZED[net], DOWN)
    state = start(system)
    memory = plugin.prepare(plugin.Config(residual=residual), system, state)
    stored = plugin.advance(system, state, memory, None, 0, 1.0).energy["springs"]
    for _ in range(10):
        report = plugin.advance(system, state, memory, None, 1, 1.0 / 60.0)
        assert report.status == "ok", report.message
    pairs, rest = system.fabric.springs.pairs(), system.fabric.springs.rest
    strain = np.linalg.norm(state.x[pairs[:, 1]] - state.x[pairs[:, 0]], axis=1) / rest - 1.0
    if "both ends" in net and residual > 1e-7:
        assert strain.max() < -0.3, "the weight is less than may be missing: balanced it stays"
    else:
        assert sum(report.energy.values()) < 2e-3 * stored
        assert np.abs(strain).max() < 1e-3


@PLUGINS
def test_a_force_that_is_no_number_does_not_converge(plugin):
    def spoil(x, v, t, out):
        out += np.nan if t > 0.015 else 0.0

    system = make_system(make_fabric(np.zeros((2, 3))), DOWN, terms=(Term("python", spoil),))
    state = start(system)
    memory = plugin.prepare(plugin.Config(), system, state)
    reports = [plugin.advance(system, state, memory, None, 1, 0.01) for _ in range(2)]
    assert [report.status for report in reports] == ["ok", "unconverged"]
    assert "residual of nan N" in reports[1].message


def test_a_search_along_which_nothing_changes_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    """A way too short to change the residual, which points uphill by rounding, has no secant: it is gone less far."""
    d, uphill = np.full((3, 2), 1e-30), np.full((3, 2), -1.0)
    linear = SimpleNamespace(linear=SimpleNamespace(x=d), direct=False)
    stage: Any = SimpleNamespace(solver=linear, residual=uphill, x=np.ones((3, 2)), v=np.zeros((3, 2)))
    monkeypatch.setattr(newton, "_evaluate", lambda *_: 1.0)
    assert newton._search(stage, cast(Any, None), stage.v, 1.0, 0.0) == 1.0
    assert (stage.x == 1.0).all() and 0.0 < stage.v.max() < 1e-30


@pytest.mark.quick(shuffle=[True])
@pytest.mark.parametrize("shuffle", [False, True])
def test_matrix_of_stretched_cloth_is_the_derivative_of_its_forces(shuffle, monkeypatch):
    monkeypatch.setattr("nuno_kernels.step.blocks.SMALL", 0)
    fabric = sheet(9, shuffle=shuffle)
    packed, rate = pack(make_system(fabric)), 200.0
    x = 1.02 * to_rows(fabric.position)
    linear = make_linear(packed)
    fill(x, rate, packed, linear)
    u = np.random.default_rng(1).standard_normal(x.shape) * ~fabric.pinned
    ahead, behind, v, e = np.empty_like(x), np.empty_like(x), np.zeros_like(x), 1e-7
    evaluate(x + e * u, v + e * rate * u, 0.0, ahead, packed)
    evaluate(x - e * u, v - e * rate * u, 0.0, behind, packed)
    expected = -fabric.mass * (ahead - behind) / (2.0 * e) * ~fabric.pinned
    np.testing.assert_allclose(multiply(linear, u, None), expected, atol=1e-8 * np.abs(expected).max())


@pytest.mark.quick(shuffle=[False])
@pytest.mark.parametrize("shuffle", [False, True])
def test_matrix_is_symmetric_and_never_negative_however_crumpled(shuffle, monkeypatch):
    monkeypatch.setattr("nuno_kernels.step.blocks.SMALL", 0)
    fabric = sheet(6, bend=1e-3 if not shuffle else 0.0, shuffle=shuffle)
    packed = pack(make_system(fabric))
    crumpled = to_rows(fabric.position) + 0.08 * np.random.default_rng(2).standard_normal((3, 36))
    linear = make_linear(packed)
    fill(crumpled, 100.0, packed, linear)
    free = np.tile(~fabric.pinned, 3)
    a = dense(linear, 36)[np.ix_(free, free)]
    np.testing.assert_allclose(a, a.T, atol=1e-10 * np.abs(a).max())
    assert np.linalg.eigvalsh(a).min() > -1e-10 * np.abs(a).max()


def test_flat_hinges_are_the_second_derivative_of_their_energy():
    """At the rest angle Gauss and Newton leave nothing out."""
    fabric = sheet(5, k=0.0, bend=1e-2)
    fabric = replace(fabric, springs=None, hinges=replace(fabric.hinges, rest=np.zeros(len(fabric.hinges.rest))))
    packed, x = pack(make_system(fabric)), to_rows(fabric.position)
    linear = make_linear(packed)
    fill(x, 1.0, packed, linear)
    u = np.random.default_rng(1).standard_normal(x.shape) * ~fabric.pinned
    ahead, behind, e = np.empty_like(x), np.empty_like(x), 1e-6
    evaluate(x + e * u, 0.0 * x, 0.0, ahead, packed)
    evaluate(x - e * u, 0.0 * x, 0.0, behind, packed)
    expected = -fabric.mass * (ahead - behind) / (2.0 * e) * ~fabric.pinned
    np.testing.assert_allclose(multiply(linear, u, None), expected, atol=1e-6 * np.abs(expected).max())


def test_conjugate_gradients_give_the_dense_solution():
    fabric = sheet(6)
    packed = pack(make_system(fabric))
    linear = make_linear(packed)
    linear.own[:3] = fabric.mass / 0.01**2
    fill(1.01 * to_rows(fabric.position), 100.0, packed, linear)
    free = np.tile(~fabric.pinned, 3)
    r = np.random.default_rng(0).standard_normal(3 * 36) * free
    expected = np.linalg.solve(dense(linear, 36)[np.ix_(free, free)], r[free])
    linear.r[...] = r.reshape(3, 36)
    iterations = solve(linear, 1e-12, 1000, None)
    assert iterations < 300
    np.testing.assert_allclose(linear.x.ravel()[free], expected, atol=1e-9 * np.abs(expected).max())


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
