"""Links of yarns in the viewer, coloured by the tension that the forces have."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenes import write_scene

from nuno.bus.encodings import encode_arrays, encode_points
from nuno.scene import scene_file
from nuno.simulation.cloth import build
from nuno.simulation.cloth.yarns import SPAN, Tensions, structural_edges, tension_arrays
from nuno_kernels.forces.yarn_tension import link_tensions
from nuno_schemas.fabric import Fabric, Float
from nuno_schemas.messages import FABRIC, STATE
from nuno_schemas.scene import View

YARNS = [
    {"name": "soft", "k": 1.0, "lock": 0.2, "k_lock": 8.0, "mu": 0.1},
    {"name": "stiff", "k": 10.0, "lock": 0.5, "k_lock": 30.0},
]


def two_knits(folder: Path) -> Fabric:
    """A tube, whose yarns are rings, and a panel, pulled about so that some links have locked."""
    models = [{"plugin": "knit", "wales": 4, "courses": 5, "form": form, "yarns": YARNS} for form in ("tube", "panel")]
    objects = [{"name": f"knit{i}", "model": model} for i, model in enumerate(models)]
    return build.build_fabric(scene_file.read(write_scene(folder, objects=objects)))[0]


def moved(fabric: Fabric) -> Float:
    return fabric.position * 1.4 + 1e-4 * np.random.default_rng(2).normal(size=fabric.position.shape)


def test_tension_is_that_of_the_forces(tmp_path: Path) -> None:
    fabric = two_knits(tmp_path)
    assert fabric.springs is not None
    x, pairs = moved(fabric), fabric.springs.pairs()
    rest = fabric.springs.per_spring(fabric.springs.rest)
    stretch = np.linalg.norm(x[pairs[:, 1]] - x[pairs[:, 0]], axis=1) / rest - 1.0
    arrays = tension_arrays(fabric) | {"edge_rest": rest.astype(np.float32)}
    expected = link_tensions(fabric, x)
    for mine in (pairs[:, 0] < 48, pairs[:, 0] >= 48):  # each object by itself: yarns do not reach across
        found = Tensions.read(arrays, mine)
        assert found is not None and found.most == pytest.approx(30.0 * rest.max())
        assert np.abs(found(stretch[mine]) - expected[mine]).max() < 1e-6 * expected.max()
    assert (stretch > 0.5).any() and (stretch < 0.2).any()


def test_links_show_their_tension_where_the_view_says_so(tmp_path: Path) -> None:
    from rrd import columns

    from nuno.viewer.cloth import TABLE
    from nuno.viewer.file import RerunFile

    fabric = two_knits(tmp_path)
    assert fabric.springs is not None
    x = moved(fabric)
    edges, rest = structural_edges(fabric)
    arrays: dict[str, Any] = {"faces": fabric.faces, "edges": edges, "edge_rest": rest.astype(np.float32)}
    arrays |= {"pinned": fabric.pinned} | tension_arrays(fabric)
    cloth = {"name": "knits", "start": 0, "stop": fabric.number, "colour": "#202020"}
    told = encode_arrays(arrays, {"vertices": fabric.number, "scene": "two", "objects": [cloth]})
    file = RerunFile(tmp_path / "run.rrd", "run", View(links="tension"))
    file.feed(FABRIC.name, 0, 0.0, told)
    file.feed(STATE.name, 0, 0.0, encode_points(x, 0.0))
    path = file.finish()
    colours = np.array(columns(path, "LineStrips3D:colors")["/world/cloth/knits/springs"][0])
    share = np.maximum(link_tensions(fabric, x) / (30.0 * rest.max()), 1.0 / SPAN)
    place = np.round(255.0 * (1.0 + np.log10(share) / np.log10(SPAN))).astype(int)
    beside = np.stack([TABLE[np.clip(place + k, 0, 255)] for k in (-1, 0, 1)])  # positions there are float32
    assert (colours == beside).any(axis=0).all() and np.ptp(place) > 100
    about = columns(path, "TextDocument:text")["/about"][0][0]
    assert f"{30.0 * rest.max():.3g} N" in about


def test_the_legend_has_the_colours_of_the_tensions_at_its_ticks() -> None:
    from nuno.viewer.bridge import SIDE, TOP, tension_legend, ticks
    from nuno.viewer.cloth import TABLE

    bar = tension_legend(2.0)[TOP + 1, SIDE:-SIDE].astype(int)
    assert [tension for _, tension in ticks(2.0)] == pytest.approx([0.002, 0.02, 0.2, 2.0])
    for share, tension in ticks(2.0):
        place = round(255.0 * (1.0 + np.log10(tension / 2.0) / np.log10(SPAN)))
        painted = int(TABLE[place]) >> np.array([24, 16, 8]) & 255
        assert np.abs(bar[round(share * (len(bar) - 1))] - painted).max() <= 3
