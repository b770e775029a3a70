"""Wind on triangles: the laws of a flat plate, and the same bits however the work is split."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from nets import wind_force
from scipy.integrate import solve_ivp

from nuno.plugin_contract import registry
from nuno_cloth.models.sheet import Sheet, SheetConfig
from nuno_cloth.models.skirt import Skirt, SkirtConfig
from nuno_cloth.wind import (
    ParticleWindConfig,
    ParticleWindForce,
    Wind,
    WindConfig,
    WindRuns,
    prepare_wind,
)
from nuno_integrators.stability import measure_rates
from nuno_kernels.terms import kernels_of
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float, State
from nuno_schemas.system import System

AIR = 1.2


def sheet(**config: object) -> Fabric:
    settings = {"size": (0.5, 0.4), "resolution": (6, 5), "plane": "xz", "fabric": "interlock"}
    return Sheet().build(SheetConfig.model_validate(settings | config), None, 0)  # type: ignore[arg-type]


def wind_on(fabric: Fabric, config: WindConfig, velocity: Float | None = None) -> Float:
    """(n, 3) forces [N]."""
    data = Wind().prepare(config, fabric, 0).data
    return wind_force(data, fabric.position, fabric.velocity if velocity is None else velocity)


def plate_law(fabric: Fabric, config: WindConfig, x: Float, v: Float) -> Float:
    """(n, 3) forces [N] from the law as it is written, triangle by triangle, at x, v (n, 3)."""
    out = np.zeros((fabric.number, 3))
    for face in fabric.faces:
        m = np.cross(x[face[1]] - x[face[0]], x[face[2]] - x[face[0]])
        area, n = 0.5 * np.linalg.norm(m), m / np.linalg.norm(m)
        u = np.array(config.velocity) - v[face].mean(axis=0)
        along = u - (u @ n) * n
        pressure, friction = abs(u @ n) * (u @ n) * n, np.linalg.norm(along) * along
        out[face] += 0.5 * config.density * area * (config.normal * pressure + config.tangential * friction) / 3.0
    return out


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
        for face in fabric.faces:
            data = prepare_wind(face[None], fabric.number, wind, AIR, 1.17, 0.01)
            assert (wind_force(data, x, np.zeros_like(x)) @ wind).min() >= 0
            assert (wind_force(data, x, np.zeros_like(x)) @ wind).max() > 0


MESHES = {
    "alternating grid": Skirt().build(SkirtConfig(columns=32, rows=9, fullness=1.3, pleats=4), None, 0),  # type: ignore[arg-type]
    "several blocks": Sheet().build(SheetConfig(size=(1.0, 1.0), resolution=(61, 83)), None, 0),  # type: ignore[arg-type]
    "narrow grid": Sheet().build(SheetConfig(size=(0.1, 1.0), resolution=(3, 40)), None, 0),  # type: ignore[arg-type]
}


@pytest.mark.quick(order=["shuffled"])
@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("order", ["as built", "shuffled", "relabelled"])
def test_every_triangle_counts_once(name: str, order: str) -> None:
    """Runs, lists and blocks add up to the law written out, whatever the order of faces and vertices."""
    fabric, generator = MESHES[name], np.random.default_rng(7)
    faces, place = fabric.faces, np.arange(fabric.number)
    if order != "as built":
        faces = np.stack(
            [np.roll(face, k) for face, k in zip(faces, generator.integers(0, 3, len(faces)), strict=True)]
        )
        faces = generator.permutation(faces)
    if order == "relabelled":
        place = generator.permutation(fabric.number)
        faces = place[faces].astype(np.int32)
    x = np.empty_like(fabric.position)
    x[place] = fabric.position + generator.normal(0, 1e-3, x.shape)
    mixed = replace(fabric, faces=faces)
    v = generator.normal(0, 1, x.shape)
    config = WindConfig(velocity=(2.0, 1.0, -3.0), tangential=0.4)
    data = Wind().prepare(config, mixed, 0).data
    expected = plate_law(mixed, config, x, v)
    assert wind_force(data, x, v) == pytest.approx(expected, rel=1e-10, abs=1e-12 * np.abs(expected).max())


def test_a_grid_goes_by_runs() -> None:
    """All triangles of a sheet but none of a shuffled one are read without indices."""
    data = Wind().prepare(WindConfig(), MESHES["several blocks"], 0).data
    assert [type(part) for part in data] == [WindRuns]


def test_falling_sheet_reaches_its_terminal_velocity() -> None:
    """m g = rho A Cn v^2 / 2, approached as v tanh(g t / v)."""
    fabric, gravity, dt = sheet(), 9.81, 1e-3
    config = WindConfig(density=AIR, normal=1.2, tangential=0.0)
    area_density = 0.187
    terminal = np.sqrt(2 * area_density * gravity / (AIR * 1.2))
    data = Wind().prepare(config, fabric, 0).data
    v = np.zeros((fabric.number, 3))
    # The mass of a vertex does not go with its share of triangles: the sheet falls as one piece.
    speeds = []
    for _ in range(1000):
        middle = v.copy()
        for _ in range(2):
            a = wind_force(data, fabric.position, middle).sum(axis=0) / fabric.mass.sum() - np.array([0, gravity, 0])
            middle = v + 0.5 * dt * a
        v = v + dt * a
        speeds.append(-v[0, 1])
    t = dt * np.arange(1, 1001)
    assert np.array(speeds) == pytest.approx(terminal * np.tanh(gravity * t / terminal), rel=1e-5)
    assert speeds[-1] == pytest.approx(terminal, rel=1e-3)


GUSTS = {"times": [0.1, 0.3, 0.4], "values": [[0.0, 0.0, 0.0], [4.0, 6.0, -2.0], [0.0, 3.0, 1.0]]}


@pytest.mark.parametrize("name", MESHES)
def test_a_gust_is_at_any_time_the_wind_between_its_times(name: str) -> None:
    """To the last bit, in runs and in lists, and held before and after them."""
    fabric, generator = MESHES[name], np.random.default_rng(3)
    if name == "narrow grid":
        fabric = replace(fabric, faces=generator.permutation(fabric.faces))
    v = generator.normal(0, 1, fabric.position.shape)
    gusts = Wind().prepare(WindConfig.model_validate({"velocity": GUSTS}), fabric, 0).data
    times, values = np.array(GUSTS["times"]), np.array(GUSTS["values"])
    for t, i, s in ((-1.0, 0, 0.0), (0.1, 0, 0.0), (0.15, 0, None), (0.3, 0, 1.0), (0.38, 1, None), (9.0, 1, 1.0)):
        share = (t - times[i]) / (times[i + 1] - times[i]) if s is None else s
        still = tuple((1.0 - share) * values[i] + share * values[i + 1])
        expected = wind_force(Wind().prepare(WindConfig(velocity=still), fabric, 0).data, fabric.position, v)
        assert np.array_equal(wind_force(gusts, fabric.position, v, t), expected)


@pytest.mark.parametrize("solver", ["symplectic_euler", "respa", "rk4", "implicit_euler", "xpbd", "leapfrog"])
def test_a_gust_carries_a_sheet_along(solver: str) -> None:
    """A free sheet across a wind that rises: m v' = rho A Cn (u(t) - v)^2 / 2. The error of its way falls with the
    step.
    """
    gust = {"times": [0.0, 0.2], "values": [[0.0, 0.0, 0.0], [0.0, 8.0, 0.0]]}
    fabric, config = sheet(), WindConfig.model_validate({"velocity": gust, "density": AIR, "tangential": 0.0})
    # With as much mass at each vertex as wind, it stays flat.
    fabric = replace(fabric, mass=np.bincount(fabric.faces.reshape(-1), minlength=fabric.number) * 1e-4)
    system, plugin = (
        System(fabric, np.zeros(3), 0.0, (Wind().prepare(config, fabric, 0),)),
        registry.load("nuno.integrators", solver),
    )
    push, off = 0.5 * AIR * 1.17 * 0.2 / fabric.mass.sum(), []
    law = solve_ivp(lambda t, y: [y[1], push * (40.0 * t - y[1]) ** 2], (0.0, 0.2), [0.0, 0.0], rtol=1e-10, atol=1e-12)
    for steps in (50, 100):
        state = State(fabric.position.copy(), fabric.velocity.copy())
        memory = plugin.prepare(plugin.Config(**({"every": 2} if solver == "respa" else {})), system, state)
        for _ in range(10):
            assert plugin.advance(system, state, memory, None, steps, 0.02 / steps).status == "ok"
        off.append(abs(float((state.x - fabric.position)[:, 1].mean()) / law.y[0, -1] - 1.0))
    assert off[0] < 0.01 and off[1] < max(0.51 * off[0], 1e-6)


def test_a_gusts_rate_is_no_less_than_that_of_its_strongest_wind() -> None:
    """Steps are chosen while the air is still: what the term declares bounds what is measured in the storm."""
    fabric, storm = sheet(), [0.0, 20.0, 5.0]
    gust = {"times": [1.0, 2.0], "values": [[0.0, 0.0, 0.0], storm]}
    declared = Wind().prepare(WindConfig.model_validate({"velocity": gust}), fabric, 0).damping_rate
    bare = replace(fabric, springs=None, hinges=None)
    steady = System(bare, np.zeros(3), 0.0, (Wind().prepare(WindConfig.model_validate({"velocity": storm}), bare, 0),))
    _, measured = measure_rates(steady, State(bare.position, bare.velocity))
    assert 0.3 * declared < measured <= declared


@pytest.mark.parametrize(
    ("times", "field"), [([0.0, 1.0, 0.5], "velocity.times[2]"), ([0.0, 1.0, 2.0, 3.0], "velocity.values")]
)
def test_gusts_that_make_no_sense_are_refused(times: list[float], field: str) -> None:
    config = WindConfig.model_validate({"velocity": GUSTS | {"times": times}})
    with pytest.raises(BadInput) as caught:
        Wind().prepare(config, sheet(), 0)
    assert caught.value.field == field


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
        return wind_force(data, x @ rotation.T, v @ rotation.T)

    assert force(turn) == pytest.approx(force(np.eye(3)) @ turn.T, abs=1e-14)


def test_degenerate_triangles_feel_nothing() -> None:
    fabric = sheet()
    collapsed = np.zeros((fabric.number, 3))
    data = Wind().prepare(WindConfig(velocity=(1.0, 1.0, 1.0)), fabric, 0).data
    assert np.abs(wind_force(data, collapsed, collapsed)).max() == 0.0


def test_particle_wind_is_the_papers_direction() -> None:
    fabric, beta, gamma = sheet(), 0.7, 1.1
    data = ParticleWindForce().prepare(ParticleWindConfig(strength=0.02, beta=beta, gamma=gamma), fabric, 0).data
    (wind,) = data
    force = np.ones((3, fabric.number))
    kernels_of(wind).find("block")(wind, 0, 0, force.copy(), force.copy(), force, 0.0)
    expected = 0.02 * np.array([np.cos(beta) * np.sin(gamma), np.sin(beta) * np.sin(gamma), np.cos(gamma)])
    assert force - 1 == pytest.approx(np.tile(expected[:, None], (1, fabric.number)), abs=1e-15)
    assert np.linalg.norm(wind.push) == pytest.approx(0.02, rel=1e-14)


def test_wind_without_triangles_is_refused() -> None:
    fabric = sheet()
    bare = Fabric("net", fabric.position, fabric.velocity, fabric.mass, fabric.pinned, np.zeros((0, 3), np.int32))
    with pytest.raises(BadInput, match="triangles"):
        Wind().prepare(WindConfig(), bare, 0)
