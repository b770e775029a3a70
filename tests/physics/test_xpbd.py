"""XPBD: backward Euler's step in the limit of many sweeps, bodies, and what is solved side by side."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from contact_world import G, contact_for, geometry, move, plane
from nets import make_fabric, make_system, random_net, start
from xpbd_nets import DOWN, POSES, STILL, advance, chain, sheet

import nuno_integrators.packing
from nuno_integrators.explicit.adaptive import Dop853
from nuno_integrators.implicit.plugin import ImplicitEuler
from nuno_integrators.packing import pack
from nuno_integrators.xpbd import XPBD
from nuno_kernels.forces.constraints import find_batches, pack_constraints
from nuno_schemas.bodies import Poses
from nuno_schemas.fabric import Springs
from nuno_schemas.system import Carried, Term


@pytest.mark.full
@pytest.mark.parametrize("shuffle", [False, True])
def test_many_sweeps_solve_the_step_of_backward_euler(shuffle, monkeypatch):
    """Springs of all kinds in runs and lists, their damping, hinges, viscous damping."""
    monkeypatch.setattr("nuno_kernels.step.blocks.SMALL", 0)
    system = make_system(sheet(12, shuffle=shuffle), DOWN, 0.7)
    ours = advance(system, 5, 5e-3, iterations=200)
    exact = advance(system, 5, 5e-3, plugin=ImplicitEuler(), residual=1e-12)
    assert np.abs(ours.x - exact.x).max() < 1e-10
    assert np.abs(ours.v - exact.v).max() < 1e-8


def test_more_sweeps_change_nothing_once_they_reach():
    system = make_system(sheet(8), DOWN, 0.7)
    ends = [advance(system, 5, 5e-3, iterations=count).x for count in (1, 3, 100, 200)]
    apart = [np.abs(end - ends[-1]).max() for end in ends[:-1]]
    assert apart[0] > 3.0 * apart[1]
    assert apart[2] < 1e-11


@pytest.mark.parametrize("iterations", [1, 3])
def test_converges_at_first_order_with_its_sweeps_fixed(iterations):
    system = make_system(sheet(6), DOWN, 0.5)
    exact = advance(system, 1, 0.1, plugin=Dop853(), tolerance=1e-11)
    counts = np.array([200, 400, 800, 1600])
    errors = [np.abs(advance(system, n, 0.1 / n, iterations=iterations).x - exact.x).max() for n in counts.tolist()]
    assert abs(-np.polyfit(np.log(counts), np.log(errors), 1)[0] - 1.0) < 0.1


@pytest.mark.parametrize("iterations", [1, 4])
def test_no_sweep_adds_momentum(iterations):
    """Nor angular momentum about where the vertices are when they are moved: only u x v of the step's path remains."""
    fabric = sheet(10, k=1e5)
    rng = np.random.default_rng(1)
    fabric = replace(
        fabric,
        position=fabric.position + 3e-3 * rng.standard_normal((100, 3)),
        velocity=rng.standard_normal((100, 3)),
        mass=rng.uniform(1e-3, 1e-2, 100),
        pinned=np.zeros(100, bool),
    )
    end = advance(make_system(fabric), 20, 1e-3, iterations=iterations)
    momentum = fabric.mass @ (end.v - fabric.velocity)
    assert np.abs(momentum).max() < 1e-12 * (fabric.mass @ np.abs(fabric.velocity)).max()
    assert np.abs(end.v - fabric.velocity).max() > 0.1


def test_a_tense_chain_is_softer_by_what_one_sweep_cannot_reach():
    """Under equal tension T the stretch is T / k, and z T / k more for each vertex between two springs, z = h^2 k / m'.

    Springs follow each other in an even and an odd round: at rest the first round has to bring T from a stretch
    s by k s / (1 + 2 z), the second from s + 2 z T / k, so that s k / T is 1 + 2 z and 1 in turns.
    """
    n, k, pull = 20, 100.0, 2.0
    for z in (0.01, 0.25, 4.0):
        mass = np.full(n + 1, 1e-2)
        fabric = replace(chain(n, k, 1e-2), mass=mass)

        def hold(x, v, t, out):
            out[-1, 1] -= pull

        system = make_system(fabric, damping=5.0, terms=(Term("python", hold),))
        h = np.sqrt(z * 1e-2 / k)
        state = advance(system, max(600, int(12.0 / h)), h)
        stretch = -state.x[-1, 1] / n - 0.1
        assert stretch * k / pull == pytest.approx(1.0 + z / (1.0 + 5.0 * h) * (n - 1) / n, rel=1e-5)


@pytest.mark.parametrize("residual", [0.1, 0.01])
@pytest.mark.parametrize("iterations", [1, 5])
def test_a_hanging_chain_stretches_as_far_as_the_stated_residual_lets_it(residual, iterations):
    n, k, mass = 10, 200.0, 0.01
    system = make_system(chain(n, k, mass), DOWN, 15.0)
    config = {"residual": residual, "iterations": iterations}
    dt = XPBD().limit(XPBD.Config(**config), system, start(system)).resolved
    state = advance(system, int(4.0 / dt), dt, **config)
    stretch = -state.x[-1, 1] - 0.1 * n
    exact = mass * G / k * n * (n + 1) / 2.0
    assert exact * (1.0 - 1e-3) < stretch < exact / (1.0 - residual)


def test_the_error_of_a_hanging_chain_falls_with_the_squared_step_and_with_sweeps():
    n, k, mass = 10, 200.0, 0.01
    system = make_system(chain(n, k, mass), DOWN, 15.0)
    exact = mass * G / k * n * (n + 1) / 2.0

    def error(dt, iterations):
        state = advance(system, int(4.0 / dt), dt, iterations=iterations)
        return (-state.x[-1, 1] - 0.1 * n) / exact - 1.0

    errors = [error(dt, 1) for dt in (4e-3, 2e-3, 1e-3)]
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.1)
    assert errors[1] / errors[2] == pytest.approx(4.0, rel=0.1)
    assert abs(error(4e-3, 60)) < 1e-6


@pytest.mark.parametrize("k", [1e2, 1e5, 1e8])
def test_no_stiffness_and_no_step_is_too_much(k):
    """Steps of a frame: it stretches, as much whatever the stiffness, but is never faster than what falls freely."""
    system = make_system(sheet(12, k=k), DOWN)
    state, plugin = start(system), XPBD()
    memory = plugin.prepare(plugin.Config(), system, state)
    assert plugin.limit(plugin.Config(), system, state).dt == np.inf
    for frame in range(1, 121):
        report = plugin.advance(system, state, memory, None, 1, 1.0 / 60.0)
        assert report.status == "ok"
        assert report.energy["kinetic"] < 0.5 * system.fabric.mass.sum() * (G * frame / 60.0) ** 2
    assert -0.7 < state.x[:, 1].min() < -0.2


@pytest.mark.parametrize("iterations", [1, 8])
@pytest.mark.parametrize("dt", [1e-3, 1.0 / 60.0])
def test_a_vertex_at_rest_sinks_m_g_over_k_at_any_step(dt, iterations):
    contact = contact_for(geometry(plane()), np.array([1e-2]), 1e4)
    move(contact, 1.0)
    fabric = make_fabric(np.array([[0.0, 1e-3, 0.0]]), mass=1e-2)
    system = make_system(fabric, DOWN, 20.0, (Term("contact", (contact,)),))
    state = advance(system, int(1.0 / dt), dt, POSES, iterations=iterations)
    assert -state.x[0, 1] == pytest.approx(1e-2 * G / 1e4, rel=1e-9)


@pytest.mark.parametrize("share", [0.9, 1.2])
def test_an_incline_holds_or_lets_go_as_coulomb_says(share):
    mu, k, mass = 0.4, 1e5, 1e-2
    alpha = np.arctan(share * mu)
    contact = contact_for(geometry(plane(), friction=mu), np.array([mass]), k)
    move(contact, 1.0)
    gravity = G * np.array([np.sin(alpha), -np.cos(alpha), 0.0])
    fabric = make_fabric(np.array([[0.0, -mass * G * np.cos(alpha) / k, 0.0]]), mass=mass)
    system = make_system(fabric, gravity, terms=(Term("contact", (contact,)),))
    half, end = (advance(system, steps, 1.0 / 400, POSES).x[0] for steps in (200, 400))
    if share < 1.0:
        assert abs(end[0] - half[0]) < 1e-12
        assert end[0] < 1e-4
    else:
        assert end[0] == pytest.approx(0.5 * G * (np.sin(alpha) - mu * np.cos(alpha)), rel=0.01)
    assert end[1] == pytest.approx(-mass * G * np.cos(alpha) / k, rel=1e-6)


def draped(n):
    """A sheet that falls on a slope with friction."""
    fabric = replace(sheet(n), pinned=np.zeros(n * n, bool))
    fabric = replace(fabric, position=fabric.position[:, [0, 2, 1]] + np.array([0.0, 1e-3, 0.0]))
    shape = geometry(plane(normal=(0.1, 0.995, 0.0)), friction=0.4)
    contact = contact_for(shape, fabric.mass, 500.0)
    move(contact, 1.0)
    return make_system(fabric, DOWN, 0.7, (Term("contact", (contact,)),))


def test_contact_and_friction_are_solved_together_with_the_cloth():
    system = draped(8)
    poses = STILL, replace(STILL, t=0.08)
    ours = advance(system, 40, 2e-3, poses, iterations=300)
    exact = advance(system, 40, 2e-3, poses, plugin=ImplicitEuler(), residual=1e-10)
    assert (ours.x @ [0.1, 0.995, 0.0] < 0.0).sum() > 15, "it touches"
    assert np.abs(ours.x - exact.x).max() < 2e-8


def test_bound_vertices_end_where_their_body_is_and_pull_the_rest():
    fabric = chain(5, 1e3, 1e-2)
    local = fabric.position[:1].copy()
    carried = Carried(np.array([0], np.int32), local, np.array([0], np.int32))
    system = make_system(fabric, carried=(carried,))
    moved = Poses(0.5, np.array([[1.0, 0.0, 0.0, 0.0]]), np.array([[0.0, 1.0, 0.0]]))
    state = advance(system, 500, 1e-3, (STILL, moved))
    np.testing.assert_allclose(state.x[0], [0.0, 1.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(state.v[0], [0.0, 2.0, 0.0], atol=1e-14)
    assert state.x[-1, 1] > 0.2


def test_forces_without_constraint_state_their_limit_and_act():
    """A drag of 400 1/s written in Python: (1 - 400 h) a step, stable below 2 / 400 s."""

    def drag(x, v, t, out):
        out -= 400.0 * 1e-3 * v

    fabric = replace(chain(1, 1e7, 1e-3), velocity=np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]))
    fabric = replace(fabric, springs=None)
    system = make_system(fabric, terms=(Term("python", drag),))
    limit = XPBD().limit(XPBD.Config(), system, start(system)).dt
    assert 0.9 * 2.0 / 400 < limit <= 2.0 / 400
    state = advance(system, 10, 1e-3)
    assert state.v[1, 0] == pytest.approx(0.6**10, rel=1e-12)


@pytest.mark.full
def test_any_number_of_threads_gives_equal_bytes(monkeypatch):
    """Of springs that lie in runs and of others."""
    monkeypatch.setattr(nuno_integrators.packing, "PARALLEL_FROM", 0)
    fabric = sheet(66, shuffle=0.5)
    runs, lists, _ = pack_constraints(pack(make_system(fabric)), False).kinds
    assert len(runs.task) > 50 and lists.ends.shape[1] > 1000
    ends = []
    for threads in (1, 2):
        contact = contact_for(geometry(plane((0, -0.002, 0)), friction=0.3), fabric.mass, 500.0)
        system = make_system(fabric, DOWN, 0.1, (Term("contact", (contact,)),), threads=threads)
        state, plugin = start(system), XPBD()
        memory = plugin.prepare(plugin.Config(iterations=2), system, state)
        assert (memory.work.packed.threads is None) == (threads == 1)
        plugin.advance(system, state, memory, POSES, 10, 2e-3)
        ends.append(state.x.tobytes() + state.v.tobytes())
    assert ends[0] == ends[1]


@pytest.mark.parametrize("shuffle", [0.0, 0.5, 1.0])
def test_what_is_solved_side_by_side_shares_no_vertex_and_nothing_is_lost(shuffle):
    fabric = sheet(80, shuffle=shuffle)
    c = pack_constraints(pack(make_system(fabric)), False)
    vertices = [set() for _ in range(int(c.colour[-1]))]
    found = []
    *runs, lists, hinges = c.kinds
    for each in runs:
        for batch, group in enumerate(vertices):
            for i, j, count in each.task[each.start[batch] : each.start[batch + 1], :3]:
                assert j - i >= 8
                found += [(i + q, j + q) for q in range(count)]
                group.update(range(i, i + count), range(j, j + count))
    bent = []
    for part, out in ((lists, found), (hinges, bent)):
        for batch, group in enumerate(vertices):
            for p in range(part.start[batch], part.start[batch + 1], 8):
                lanes = [tuple(part.ends[:, q]) for q in range(p, p + 8) if len(set(part.ends[:, q])) > 1]
                used = [vertex for lane in lanes for vertex in lane]
                assert len(used) == len(set(used))
                out += lanes
                group.update(part.ends[:, p : p + 8].ravel().tolist())
    assert sorted(tuple(sorted(map(int, pair))) for pair in found) == sorted(
        tuple(sorted(pair)) for pair in fabric.springs.pairs().tolist()
    )
    assert sorted(tuple(map(int, q)) for q in bent) == sorted(map(tuple, fabric.hinges.quads().tolist()))
    for first, last in zip(c.colour[:-1], c.colour[1:], strict=True):
        used = [vertex for group in vertices[first:last] for vertex in group]
        assert len(used) == len(set(used))


def test_a_sheet_has_three_colours_and_chaos_two(monkeypatch):
    """Blocks, even seams, odd seams; where there are too many sets of blocks to tell apart, one batch crosses."""
    rows = np.array([[0, 0], [0, 1], [1, 1], [1, 2], [2, 3], [2, 2], [3, 3]])
    (batch,), colour = find_batches([rows])
    assert colour.tolist() == [0, 4, 6, 7]
    assert batch.tolist() == [0, 4, 1, 6, 5, 2, 3]
    monkeypatch.setattr("nuno_kernels.forces.constraints.MOST_BATCHES", 5)
    (batch,), colour = find_batches([rows])
    assert colour.tolist() == [0, 4, 5]
    assert batch.tolist() == [0, 4, 1, 4, 4, 2, 3]


def test_a_vertex_of_a_hundred_springs_is_coloured_too():
    """More than a mask holds: the rest go alone. All springs pull alike, and the middle stays."""
    n = 101
    angle = np.linspace(0.0, 2.0 * np.pi, n - 1, endpoint=False)
    x = np.concatenate([np.zeros((1, 3)), np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], 1)])
    pairs = np.stack([np.zeros(n - 1, np.int32), np.arange(1, n, dtype=np.int32)], 1)
    springs = Springs.from_pairs(pairs, np.full(n - 1, 10.0), np.full(n - 1, 0.9), np.zeros(n - 1))
    system = make_system(make_fabric(x, springs, None, 1e-2))
    (lists,) = pack_constraints(pack(system), False).kinds
    assert (lists.ends[0] != lists.ends[1]).sum() == n - 1
    ours = advance(system, 10, 5e-3, iterations=1000)
    exact = advance(system, 10, 5e-3, plugin=ImplicitEuler(), residual=1e-12)
    assert np.abs(ours.x - exact.x).max() < 1e-9


def test_a_random_net_is_solved_as_well():
    position, springs = random_net(40, 200, 3, c=0.2)
    system = make_system(make_fabric(position, springs, mass=0.1), DOWN, 0.3)
    ours = advance(system, 5, 1e-2, iterations=1000)
    exact = advance(system, 5, 1e-2, plugin=ImplicitEuler(), residual=1e-12)
    assert np.abs(ours.x - exact.x).max() < 1e-9
