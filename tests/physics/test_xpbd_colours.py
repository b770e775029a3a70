"""What XPBD solves side by side: no vertex twice, nothing lost, the same bytes on any number of threads."""

from __future__ import annotations

import numpy as np
import pytest
from contact_world import contact_for, geometry, plane
from nets import make_fabric, make_system, random_net, start
from xpbd_nets import DOWN, POSES, advance, sheet

import nuno_integrators.packing
from nuno_integrators.implicit.plugin import ImplicitEuler
from nuno_integrators.packing import pack
from nuno_integrators.xpbd import XPBD
from nuno_kernels.forces.constraints import find_batches, pack_constraints
from nuno_schemas.fabric import Springs
from nuno_schemas.system import Term


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
