"""Wind on triangles: the laws of a flat plate, and the same bits however the work is split."""

from __future__ import annotations

import numpy as np
import pytest

from nuno_cloth.sheet import Sheet, SheetConfig
from nuno_cloth.skirt import Skirt, SkirtConfig
from nuno_cloth.wind import ParticleWindConfig, ParticleWindForce, Wind, WindConfig
from nuno_kernels.wind import ParticleWind, add_particle_wind, add_wind, gather_wind, measure_wind
from nuno_kernels.wind import Wind as WindData
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float

AIR = 1.2


def sheet(**config: object) -> Fabric:
    settings = {"size": (0.5, 0.4), "resolution": (6, 5), "plane": "xz", "fabric": "interlock"}
    return Sheet().build(SheetConfig.model_validate(settings | config), None, 0)  # type: ignore[arg-type]


def wind_on(fabric: Fabric, config: WindConfig, velocity: Float | None = None) -> Float:
    """(n, 3) forces [N]."""
    data = Wind().prepare(config, fabric, 0).data
    assert isinstance(data, WindData)
    force = np.zeros((3, fabric.number))
    moving = fabric.velocity if velocity is None else velocity
    add_wind(np.ascontiguousarray(fabric.position.T), np.ascontiguousarray(moving.T), data, force)
    return np.ascontiguousarray(force.T)


@pytest.mark.parametrize("angle", [0.0, 0.4, 1.2])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_plate_at_an_angle(angle: float, sign: float) -> None:
    """rho A / 2 (Cn |u.n| (u.n) n + Ct |u_t| u_t), whichever side the wind blows on."""
    fabric, speed = sheet(), 3.0
    u = sign * speed * np.array([np.sin(angle), np.cos(angle), 0.0])
    config = WindConfig.model_validate({"velocity": u.tolist(), "density": AIR, "normal": 1.1, "tangential": 0.3})
    across, along = u[1], u[0]
    expected = 0.5 * AIR * 0.2 * np.array([0.3 * abs(along) * along, 1.1 * abs(across) * across, 0.0])
    assert wind_on(fabric, config).sum(axis=0) == pytest.approx(expected, rel=1e-12, abs=1e-15)


def test_no_force_along_the_cloth_without_friction() -> None:
    config = WindConfig(velocity=(4.0, 0.0, -2.0), tangential=0.0)
    assert np.abs(wind_on(sheet(), config)).max() == 0.0


def test_no_force_when_moving_with_the_wind() -> None:
    fabric = Skirt().build(SkirtConfig(columns=16, rows=5), None, 0)  # type: ignore[arg-type]
    wind = (1.0, -2.0, 3.0)
    force = wind_on(fabric, WindConfig(velocity=wind), np.tile(wind, (fabric.number, 1)))
    assert np.abs(force).max() < 1e-25


def test_wind_does_no_negative_work_on_still_cloth() -> None:
    """On every face the force has a component along the relative wind: drag never pushes back."""
    fabric = sheet()
    generator = np.random.default_rng(0)
    x = fabric.position + generator.normal(0, 0.05, fabric.position.shape)
    for wind in generator.normal(0, 3, (10, 3)):
        data = Wind().prepare(WindConfig(velocity=tuple(wind)), fabric, 0).data
        assert isinstance(data, WindData)
        measure_wind(np.ascontiguousarray(x.T), np.zeros((3, fabric.number)), data, 0, len(fabric.faces))
        assert (wind @ data.face_force).min() > 0


def test_falling_sheet_reaches_its_terminal_velocity() -> None:
    """m g = rho A Cn v^2 / 2, approached as v tanh(g t / v)."""
    fabric, gravity, dt = sheet(), 9.81, 1e-3
    config = WindConfig(density=AIR, normal=1.2, tangential=0.0)
    area_density = 0.187
    terminal = np.sqrt(2 * area_density * gravity / (AIR * 1.2))
    data = Wind().prepare(config, fabric, 0).data
    x, v = np.ascontiguousarray(fabric.position.T), np.zeros((3, fabric.number))
    # The mass of a vertex does not go with its share of triangles: the sheet falls as one piece.
    speeds = []
    for _ in range(1000):
        middle = v.copy()
        for _ in range(2):
            force = np.zeros_like(v)
            add_wind(x, middle, data, force)
            a = force.sum(axis=1) / fabric.mass.sum() - np.array([0, gravity, 0])
            middle = v + 0.5 * dt * a[:, None]
        v = v + dt * a[:, None]
        speeds.append(-v[1, 0])
    t = dt * np.arange(1, 1001)
    assert np.array(speeds) == pytest.approx(terminal * np.tanh(gravity * t / terminal), rel=1e-5)
    assert speeds[-1] == pytest.approx(terminal, rel=1e-3)


def test_wind_turns_with_the_world() -> None:
    """Forces are vectors: rotating cloth and wind rotates them."""
    fabric = sheet()
    generator = np.random.default_rng(5)
    x, v = fabric.position + generator.normal(0, 0.03, (fabric.number, 3)), generator.normal(0, 1, (fabric.number, 3))
    turn, _ = np.linalg.qr(generator.normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    wind = np.array([2.0, 1.0, -3.0])

    def force(rotation: Float) -> Float:
        data = Wind().prepare(WindConfig(velocity=tuple(rotation @ wind)), fabric, 0).data
        out = np.zeros((3, fabric.number))
        add_wind(np.ascontiguousarray(rotation @ x.T), np.ascontiguousarray(rotation @ v.T), data, out)
        return out

    assert force(turn) == pytest.approx(turn @ force(np.eye(3)), abs=1e-14)


def test_the_same_bits_however_the_work_is_split() -> None:
    fabric = Skirt().build(SkirtConfig(columns=32, rows=9, fullness=1.3, pleats=4), None, 0)  # type: ignore[arg-type]
    data = Wind().prepare(WindConfig(velocity=(1.0, 0.5, 0.2)), fabric, 0).data
    assert isinstance(data, WindData)
    x = np.ascontiguousarray(fabric.position.T)
    whole, split = np.zeros_like(x), np.zeros_like(x)
    add_wind(x, np.zeros_like(x), data, whole)
    data.face_force[:] = np.nan
    for first in reversed(range(0, len(fabric.faces), 37)):
        measure_wind(x, np.zeros_like(x), data, first, min(first + 37, len(fabric.faces)))
    for first in reversed(range(0, fabric.number, 11)):
        gather_wind(data, split, first, min(first + 11, fabric.number))
    assert whole.tobytes() == split.tobytes()
    assert np.abs(whole).min(axis=1).max() > 0


def test_degenerate_triangles_feel_nothing() -> None:
    fabric = sheet()
    collapsed = np.zeros((3, fabric.number))
    out = np.zeros_like(collapsed)
    add_wind(collapsed, collapsed, Wind().prepare(WindConfig(velocity=(1.0, 1.0, 1.0)), fabric, 0).data, out)
    assert np.abs(out).max() == 0.0


def test_particle_wind_is_the_papers_direction() -> None:
    fabric, beta, gamma = sheet(), 0.7, 1.1
    data = ParticleWindForce().prepare(ParticleWindConfig(strength=0.02, beta=beta, gamma=gamma), fabric, 0).data
    assert isinstance(data, ParticleWind)
    force = np.ones((3, fabric.number))
    add_particle_wind(data, force)
    expected = 0.02 * np.array([np.cos(beta) * np.sin(gamma), np.sin(beta) * np.sin(gamma), np.cos(gamma)])
    assert force - 1 == pytest.approx(np.tile(expected[:, None], (1, fabric.number)), abs=1e-15)
    assert np.linalg.norm(data.force) == pytest.approx(0.02, rel=1e-14)


def test_wind_without_triangles_is_refused() -> None:
    fabric = sheet()
    bare = Fabric("net", fabric.position, fabric.velocity, fabric.mass, fabric.pinned, np.zeros((0, 3), np.int32))
    with pytest.raises(BadInput, match="triangles"):
        Wind().prepare(WindConfig(), bare, 0)
