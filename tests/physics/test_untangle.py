"""Untangling: cloth comes apart, on the right side, by no more than it has to; pins stay; the same bits again."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tangles import EDGE, KINDS, SIDE, Random, Sheet, across, bump, cloth_of, crosses, moved, poke, sheet, tangle

from nuno.scene import scene_file, shipped
from nuno.simulation.run import Simulation
from nuno_contact.untangle.plugin import Untangle, UntangleConfig
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Bool, Fabric, Float, Int, State
from nuno_schemas.operation import Arranged

GAP = 1e-3


def untangle(
    fabric: Fabric, objects: dict[str, Int], meet: Bool | None = None, gap: float = GAP, iterations: int = 1000
) -> Arranged:
    """Where cloth comes to start."""
    every = np.ones((len(objects), len(objects)), bool)
    config = UntangleConfig(gap=gap, iterations=iterations)
    return Untangle().arrange(config, fabric, objects, every if meet is None else meet, None)


def draws(seed: int, irregular: bool) -> tuple[Random, Random | None]:
    """What a kind of tangle is drawn from."""
    random = np.random.default_rng(seed)
    return random, random if irregular else None


def over(upper: Float, lower: Float) -> Float:
    """(n,) how far vertices are above those of a nearly level sheet that are nearest as seen from above [m]."""
    far = ((upper[:, None, [0, 2]] - lower[None, :, [0, 2]]) ** 2).sum(axis=2)
    return np.asarray(upper[:, 1] - lower[far.argmin(axis=1), 1])


@pytest.mark.quick(seeds=[2])
@pytest.mark.parametrize("seeds", [2, 30])
@pytest.mark.parametrize("irregular", [False, True])
@pytest.mark.parametrize("kind", KINDS)
def test_cloth_comes_apart(kind: str, irregular: bool, seeds: int) -> None:
    """As ipc-toolkit sees it, and no vertex by more than 0.75 of a sheet's width, of which up to 0.6 is to be gone."""
    tangled = 0
    for seed in range(seeds):
        fabric, objects = tangle(kind, seed, irregular)
        begun = fabric.position.copy()
        tangled += crosses(fabric, begun)
        made = untangle(fabric, objects)
        assert not crosses(fabric, made.position), seed
        assert made.facts["largest"] < 0.75 * EDGE * SIDE, seed
        assert fabric.position.tobytes() == begun.tobytes()
    assert tangled > 0.9 * seeds


@pytest.mark.parametrize("irregular", [False, True])
def test_what_was_pushed_through_comes_back_on_its_side(irregular: bool) -> None:
    """A dent that came out below is above again, and an upright sheet above the one that it was pushed through, however
    many edges deep; nothing has gone farther than the depth.
    """
    for made in (bump, poke):
        for seed in range(6):
            fabric, objects = cloth_of(made(*draws(seed, irregular)))
            depth = -float(fabric.position[objects["sheet0"], 1].min())
            assert depth > 0.4 * EDGE
            found = untangle(fabric, objects)
            assert over(*(found.position[vertices] for vertices in objects.values())).min() > 0.0, (made, seed)
            assert found.facts["largest"] <= depth, (made, seed)


@pytest.mark.full
def test_cloth_that_fell_through_itself_comes_apart() -> None:
    """The folds below a ball, after two thirds of a second without cloth contact: hundreds of crossings."""
    simulation = Simulation.with_bodies(scene_file.read(shipped.find("drape-over-sphere"), ["cloth_contact=none"]), 1)
    for _ in range(40):
        simulation.step()
    fabric = replace(simulation.fabric, position=simulation.state.x)
    made = untangle(fabric, {"cloth": np.arange(fabric.number, dtype=np.int32)})
    assert made.facts["crossings"] > 500
    assert not crosses(fabric, made.position)


def test_pieces_come_to_have_the_gap() -> None:
    """Also one that is nearly as long as an edge."""
    for gap in (1e-3, 0.8 * EDGE):
        fabric, objects = tangle("bump", 1, False)
        x = untangle(fabric, objects, gap=gap).position
        upper, lower = (x[vertices] for vertices in objects.values())
        near = np.sqrt(((upper[:, None] - lower) ** 2).sum(axis=2)).min()
        assert gap <= near
        assert over(upper, lower).min() >= 0.9 * gap


def test_what_does_not_cross_keeps_its_bits() -> None:
    """Also where it is nearer than the gap, or of one piece, or has no triangles."""
    for sheets in ([sheet(None), moved(sheet(None), 0.0, 0.1 * GAP, 0.0)], [sheet(np.random.default_rng(1))]):
        fabric, objects = cloth_of(sheets)
        made = untangle(fabric, objects)
        assert made.position.tobytes() == fabric.position.tobytes()
        assert made.facts["crossings"] == made.facts["largest"] == made.facts["vertices"] == 0.0
    bare = replace(fabric, faces=np.zeros((0, 3), np.int32))
    assert untangle(bare, objects).position.tobytes() == fabric.position.tobytes()


def test_grids_that_meet_edge_on_edge_come_apart() -> None:
    """Vertices on edges and edges on edges, exactly."""
    upright: Sheet = sheet(None)[0][:, [0, 2, 1]].copy(), sheet(None)[1]
    for at in (0.0, 0.5 * EDGE):
        fabric, objects = cloth_of([moved(upright, 0.0, at + 0.03, at), sheet(None)])
        made = untangle(fabric, objects)
        assert made.facts["crossings"] > 0.0
        assert not crosses(fabric, made.position)


def test_pins_stay_and_the_rest_goes_round_them() -> None:
    """To the bit; and where one sheet is held altogether, the other goes all the way."""
    for held in ("row", "all"):
        fabric, objects = cloth_of(bump(*draws(3, False)))
        pinned = np.zeros(fabric.number, bool)
        pinned[objects["sheet1"][: SIDE if held == "row" else None]] = True
        made = untangle(replace(fabric, pinned=pinned), objects)
        assert made.position[pinned].tobytes() == fabric.position[pinned].tobytes()
        assert not crosses(fabric, made.position)


def test_what_is_pinned_through_each_other_is_told_by_number_and_place() -> None:
    """And what is not given enough iterations; nothing is changed by that."""
    fabric, objects = cloth_of(across(*draws(0, False)))
    begun = fabric.position.tobytes()
    with pytest.raises(BadInput) as caught:
        untangle(replace(fabric, pinned=np.ones(fabric.number, bool)), objects, iterations=20)
    assert "44 edges through triangles of 44, 44 with vertices that are held" in caught.value.problem
    assert "of sheet0 through triangle" in str(caught.value.value) and "m" in str(caught.value.value)
    with pytest.raises(BadInput, match="after 1 iterations"):
        untangle(fabric, objects, iterations=1)
    assert fabric.position.tobytes() == begun


def test_pieces_that_may_pass_through_each_other_are_left_alone() -> None:
    fabric, objects = tangle("across", 1, True)
    made = untangle(fabric, objects, meet=np.eye(2, dtype=bool))
    assert made.position.tobytes() == fabric.position.tobytes()


def test_applied_to_one_fabric_it_moves_the_state_alone() -> None:
    """From where the state is; the fabric's own start and velocities stay."""
    fabric, _ = tangle("fold", 1, True)
    flat = replace(fabric, position=np.zeros_like(fabric.position))
    state = State(fabric.position.copy(), np.ones_like(fabric.position), 0.5)
    made = Untangle().apply(UntangleConfig(gap=GAP), flat, state, None)
    assert made.changed is not None
    assert crosses(fabric, state.x) and not crosses(fabric, made.changed.state.x)
    assert made.changed.fabric is flat and made.changed.state.v.tobytes() == state.v.tobytes()


def digest() -> str:
    """Of where three tangles come to start."""
    found = [untangle(*tangle(kind, 5, True)).position for kind in ("layers", "fold", "crumple")]
    return hashlib.sha256(np.concatenate(found).tobytes()).hexdigest()


@pytest.mark.full
def test_the_same_bits_whatever_the_threads() -> None:
    """In another process with one thread, and in this one twice."""
    one = dict.fromkeys(("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    told = subprocess.run(
        [sys.executable, "-c", "from test_untangle import digest; print(digest())"],
        env=os.environ | one, cwd=Path(__file__).parent, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert told.stdout.strip() == digest() == digest()
