"""Every plugin that comes with nuno keeps the contract of its kind."""

from __future__ import annotations

import json
from collections.abc import Mapping
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import animated_tube
import numpy as np
import pytest
from model_files import Folder, files
from persons import person_file
from sewing_patterns import tube

from nuno_schemas.plugin import GROUPS
from nuno_testing import bodies, checks, contract, integrators
from nuno_testing import checks as forces
from nuno_testing import integrators as rides

__all__ = ["files"]
SCENES = Path(__file__).resolve().parents[2] / "scenes"
TAU3 = {"I": 0.5, "II": 0.05, "III": 0.1, "IV": 1, "V": 0.9}
WHOLE = {"I": 0.5, "II": 0.05}
EXAMPLES: dict[str, dict[str, dict[str, Any]]] = {
    "nuno.models": {
        "sheet": {"resolution": [7, 5], "size": ["60 cm", 0.4], "pin": ["top-row", 20]},
        "skirt": {"columns": 64, "rows": 24, "fullness": 1.3, "pleats": 8, "attach": {"body": "b", "frame": "hips"}},
        "shirt": {"over": {"body": "b"}},
        "pattern": {"file": "tube.json", "edge": "3 cm"},
        "mesh": {"file": "sheet.obj", "fabric": "jacket", "pin": [0]},
        "swatch": {"radius": 0.04, "hold": 0.02, "fabric": {"preset": "denim", "hysteresis_warp": 4e-4}},
        "net": {"file": "net.npz"},
        "knit": {"wales": 4, "courses": 5, "form": "tube", "pin": ["top-row"]},
    },
    "nuno.forces": {"wind": {}, "particle_wind": {"strength": 1e-3}},
    "nuno.integrators": {
        name: {}
        for name in ("euler", "symplectic_euler", "respa", "leapfrog", "rk4", "rk4_printed", "dopri5", "dop853",
                     "implicit_euler", "tr_bdf2", "xpbd")
    },
    "nuno.colliders": {
        "capsule": {"a": [0, 0, 0], "b": ["10 cm", 0, 0], "radius": "3 cm"},
        "sphere": {"centre": [0, 1, 0], "radius": 0.3},
        "plane": {"point": [0, "1 mm", 0], "normal": [0, 3, 4]},
        "box": {"centre": [1, 0, 0], "size": [1, "20 cm", 3]},
        "skeleton": {},
        "mesh": {"shape": "leg", "resolution": 24},
        "sdf": {"shape": "leg", "resolution": 24, "tolerance": "2 mm"},
        "skin": {"file": "person.obj", "stand": "0.1 s", "blend": "0.5 s"},
        "surface": {},
    },
    "nuno.motions": {
        "keyframes": {"times": [0, 1, 3], "rotations": [[0, 0, 0], [0, 1, 0.5], [1, 0, 0]], "between": "ease"},
        "bvh": {"file": "walk.bvh"},
        "hula": {},
        "animation": {"file": "hero.npz", "start": "0.1 s", "preroll": "0.2 s", "up": "z", "scale": "10 cm"},
        "topic": {"key": "robot/hand", "position": [0, "1 m", 0], "frames": "poses", "silence": "2 s"},
    },
    "nuno.contacts": {"penalty": {}, "sliding": {}},
    "nuno.cloth_contacts": {"offset": {}},
    "nuno.operations": {
        "attach": {"body": "hand", "within": "1 cm"},
        "pressure": {},
        "release": {"vertices": [0]},
        "repair": {},
        "smooth": {},
        "untangle": {},
        "wrinkle": {"lines": [{"texture": [[0.2, 0.4], [0.8, 0.6]], "height": 0.01}]},
    },
    "nuno.renderers": {"raster": {}, "paths": {"samples": 4}},
    "nuno.dye_cloths": {
        "cells": {"file": "cells.npz", "cell_size": "0.1 mm", "tau3": TAU3},
        "woven": {"tau3": TAU3},
        "photograph": {"file": "photo.png", "masks": {"warp": "a.png", "weft": "b.png"}, "tau3": WHOLE},
    },
    "nuno.dye_solvers": {"explicit": {}, "rkl2": {}, "implicit": {"residual": 1e-11}},
    "nuno.dye_pictures": {"yarns": {}, "photograph": {}},
    "nuno.yarn_pictures": {"yarns": {}, "lines": {}, "density": {}, "map": {}},
    "nuno.isotherms": {"partition": {"k": 0.7}, "freundlich": {"k": 0.4, "b": 0.35}, "langmuir": {"K": 2.0}},
}  # fmt: skip


@pytest.fixture
def nuno_folder(files: Folder) -> Path:
    """A mesh, a net, a pattern, a person and a motion."""
    (files.root / "tube.json").write_text(json.dumps(tube()))
    (files.root / "person.obj").write_text(person_file(0.025))
    (files.root / "walk.bvh").write_bytes((SCENES / "walk.bvh").read_bytes())
    (x, faces), times = animated_tube.tube(), animated_tube.times(25)
    animated_tube.write_npz(
        files.root / "hero.npz", np.stack([animated_tube.posed(x, t) for t in times]), faces, times=times
    )
    return files.root


@pytest.mark.parametrize("group", sorted(GROUPS))
def test_every_plugin_of_a_kind_is_tried(group: str) -> None:
    assert set(EXAMPLES[group]) == {point.name for point in entry_points(group=group)}


@pytest.mark.parametrize("group", sorted(group for group in GROUPS if ": " in GROUPS[group]))
def test_a_kinds_description_names_every_plugin_of_it(group: str) -> None:
    own = {point.name for point in entry_points(group=group) if point.dist and point.dist.name == "nuno"}
    assert set(GROUPS[group].partition(": ")[2].split(", ")) == own


NEEDED = {"paths": "mitsuba"}
"""Packages of extras that plugins need."""


@pytest.fixture(autouse=True)
def needed(request: pytest.FixtureRequest) -> None:
    """Skip a plugin by name where its package is not installed."""
    name = getattr(request.node, "callspec", None) and request.node.callspec.params.get("name")
    if name in NEEDED:
        pytest.importorskip(NEEDED[name])


LONG = ("particle_wind", "euler", "rk4_printed", "dopri5", "shirt", "implicit", "skin")
"""Plugins whose kernels or cloth take long to make, beside others of their kind that take their paths."""
OF_FEW = {
    # Every step compiled once more, for two threads: of nuno's own solvers other tests look at those, too.
    rides.any_number_of_threads_gives_the_same_bits: (),
    # And for bodies that carry and meet cloth, or for a single vertex without a force: one solver of each way to step.
    rides.all_is_the_same_on_a_body_that_moves_evenly: ("symplectic_euler", "implicit_euler", "xpbd"),
    rides.friction_slows_what_slides_and_holds_what_stands: ("symplectic_euler", "implicit_euler", "xpbd"),
    integrators.a_vertex_that_nothing_acts_on_stays_where_it_is: ("symplectic_euler", "implicit_euler"),
    # Of first order, twelve thousand steps that are solved to rounding; tr_bdf2 takes its steps by the same solver.
    integrators.the_error_falls_with_the_stated_order: (
        "symplectic_euler",
        "respa",
        "leapfrog",
        "rk4",
        "dop853",
        "tr_bdf2",
        "xpbd",
    ),
    # The hula's own tests bound its jerks.
    bodies.it_moves_without_jumps: ("keyframes", "bvh", "topic"),
    # Grains without springs, and wind on an implicit step: kernels that nothing else needs.
    checks.what_falls_on_a_body_comes_to_rest_on_it: ("penalty",),
    forces.an_implicit_step_ends_where_its_equation_says: (),
    # Wind compiled once more, for two threads.
    forces.any_number_of_threads_gives_the_same_bits: (),
}
"""Checks of which the cases of these plugins alone are quick."""


def is_quick(parameters: Mapping[str, Any]) -> bool:
    name, check = parameters["name"], parameters["check"]
    return name not in LONG and name in OF_FEW.get(check, (name,))


for group in GROUPS:
    globals()[f"test_{group.removeprefix('nuno.')}"] = pytest.mark.quick.with_args(is_quick)(
        contract(group, **EXAMPLES[group])
    )
