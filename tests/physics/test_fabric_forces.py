"""The compiled forces on real garments are those of the readable energies, wind included."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from nets import accelerations, make_system, wind_force

from nuno_cloth.fabrics.kes import elastic_energy
from nuno_cloth.models.sheet import Sheet
from nuno_cloth.models.skirt import Skirt
from nuno_cloth.wind import ParticleWindConfig, ParticleWindForce, Wind, WindConfig

GARMENTS: list[tuple[Any, dict[str, Any]]] = [
    (Sheet(), {"resolution": (9, 13), "size": (0.2, 0.3), "pin": ["top-row"], "fabric": "jacket"}),
    (Skirt(), {"columns": 64, "rows": 16, "fullness": 1.3, "pleats": 8, "fabric": "trousers"}),
    (Skirt(), {"columns": 6, "rows": 3, "length": 0.3, "fabric": {"density": 0.2, "structural": 50, "bending": 5}}),
]


@pytest.mark.parametrize(("model", "config"), GARMENTS)
def test_compiled_forces_are_the_energies_gradients(model: Any, config: dict[str, Any]) -> None:
    fabric = model.build(model.Config.model_validate(config), None, 0)
    generator = np.random.default_rng(2)
    x = fabric.position + generator.normal(0, 1e-3, fabric.position.shape)
    still = np.zeros_like(x)
    force = -elastic_energy(fabric, x)[1]
    wind = Wind().prepare(WindConfig(velocity=(3.0, 1.0, -2.0)), fabric, 0)
    push = ParticleWindForce().prepare(ParticleWindConfig(strength=1e-3, beta=0.3, gamma=0.8), fabric, 0)
    blown = wind_force(wind.data, x, still)
    expected = (force + blown + push.data[0].force) / fabric.mass[:, None]
    got = accelerations(make_system(fabric, terms=(wind, push)), x, still)
    free = ~fabric.pinned
    assert got[free] == pytest.approx(expected[free], rel=1e-9, abs=1e-9 * np.abs(expected).max())
    assert not got[fabric.pinned].any()
