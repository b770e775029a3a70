"""The renderer `paths`: one picture from meshes and a camera, by following light through many paths."""

from __future__ import annotations

import functools
import importlib.util
import math
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel
from scipy.ndimage import uniform_filter1d

from nuno_render.annotate import annotate
from nuno_render.config import PathsConfig
from nuno_render.raster import encode_picture
from nuno_render.refine import refine
from nuno_render.scene import DrawnScene, albedo_of, gather
from nuno_render.shading.fibre import NYLON, find_absorption
from nuno_render.shading.ground import Ground, find_ground
from nuno_render.shading.lighting import GROUND, KEY, SKY, key_direction, tangents, unit
from nuno_render.sight import Sight, sight_of
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float
from nuno_schemas.pictures import SKIN, Camera, Mesh, Pass

# Cloth's materials: sheen, weave or stitches, and light through it.


class Look(NamedTuple):
    """A weave (plain, twill, satin, jersey or rib), the pitch of its yarns or wales [m], the share of light that yarns
    reflect (gloss), its roughness along and across them, the strength of the velvet-like sheen, the share of diffuse
    light that passes (thin), that of white in the colour of the weft, which in denim is not dyed, and the standard
    deviation of the yarns' brightness (slub).
    """

    weave: str = "plain"
    pitch: float = 0.4e-3
    gloss: float = 0.03
    along: float = 0.35
    across: float = 0.55
    sheen: float = 0.3
    thin: float = 0.1
    weft: float = 0.0
    slub: float = 0.04


LOOKS = {
    "denim": Look("twill", 0.55e-3, 0.01, 0.5, 0.7, 0.15, 0.0, 0.45, 0.2),
    "interlock": Look("jersey", 0.9e-3, 0.01, 0.5, 0.6, 0.8, 0.1, 0.0, 0.02),
    "rib-knit": Look("rib", 1.1e-3, 0.01, 0.5, 0.6, 0.8, 0.05, 0.0, 0.03),
    "polyester": Look("plain", 0.3e-3, 0.08, 0.25, 0.45, 0.15, 0.1, 0.0, 0.02),
    "jacket": Look("plain", 0.3e-3, 0.1, 0.25, 0.45, 0.1, 0.1, 0.0, 0.02),
    "trousers": Look("twill", 0.4e-3, 0.02, 0.4, 0.6, 0.35, 0.0, 0.0, 0.05),
    "swimwear": Look("jersey", 0.3e-3, 0.12, 0.28, 0.4, 0.1, 0.05, 0.0, 0.0),
    "silk": Look("satin", 0.12e-3, 0.4, 0.14, 0.32, 0.1, 0.15, 0.0, 0.01),
    "chiffon": Look("plain", 0.2e-3, 0.08, 0.25, 0.45, 0.1, 0.5, 0.0, 0.02),
    "wool": Look("twill", 0.9e-3, 0.01, 0.5, 0.7, 0.9, 0.0, 0.0, 0.07),
    "linen": Look("plain", 0.6e-3, 0.04, 0.3, 0.5, 0.2, 0.1, 0.0, 0.12),
    "canvas": Look("plain", 0.8e-3, 0.02, 0.5, 0.6, 0.25, 0.0, 0.0, 0.06),
    "leather": Look("plain", 0.2e-3, 0.12, 0.35, 0.35, 0.0, 0.0, 0.0, 0.0),
}
"""By the names of presets. Weaves and pitches are usual for such cloth; the rest, which no source has, was chosen by
eye."""

YARNS, PIXELS = 120, 10
"""Yarns along a side of a repeating texture, which all weaves divide, and its pixels a yarn."""
PERIODS = {"plain": 1.4, "twill": 2.8, "satin": 2.2, "jersey": 1.0, "rib": 4.0}
"""Least distance at which weaves and stitches repeat, in pitches. Below 1.5 pixels, which would show lines that cloth
has not, they are drawn by their mean, and from 2.5 pixels on with all their contrast."""
RELIEF, CAVITY = 0.35, 0.4
"""Height of yarns over the places between them, in pitches, and the share of light that does not reach these."""


@functools.cache
def draw_tile(weave: str, slub: float) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Return the texture of a weave, or of the stitches of a knit, whose wales are warps: 1 where the warp is on top,
    height [pitches] and brightness, of mean 1, each (p, p).
    """
    y, x = (np.mgrid[: YARNS * PIXELS, : YARNS * PIXELS] + 0.5) / PIXELS
    random, row, column = np.random.default_rng(0), np.floor(y).astype(int), np.floor(x).astype(int)
    # Each yarn has its own brightness, and thick places a few cm long.
    places = uniform_filter1d(random.standard_normal((2, YARNS, YARNS)), YARNS // 3, axis=1, mode="wrap")
    spun = 1.0 + 0.7 * slub * (random.standard_normal((2, 1, YARNS)) + np.sqrt(YARNS // 3) * places)
    warps, wefts = spun[0][row, column], spun[1][column, row]
    if weave in ("jersey", "rib"):
        # The two legs of a stitch lean outwards from its foot, which the head of the stitch below holds; each is thick
        # in its middle, and ends beneath the next course.
        rise, side = 1.0 - y % 1.0, np.abs(x % 1.0 - 0.5)
        height = np.maximum(*(
            _round((side - 0.1 - 0.17 * (rise + k)) / 0.18) * _round((rise + k) / 0.9 - 1.0) - 0.3 * k for k in (0, 1)
        ))  # fmt: skip
        # Wales are round, with grooves between them.
        height, warp = height + 0.8 * _round(2.0 * side), np.ones_like(x)
        height += 0.8 * (weave == "rib") * np.sin(2.0 * np.pi * x / 4.0)
    else:
        step, float_of = {"plain": (1, 2), "twill": (1, 4), "satin": (2, 5)}[weave]
        up = ((row + step * column) % float_of != 0).astype(float)
        # Yarns bend between above and below over a pitch: the mean of what is on top along the yarn.
        warp_top, weft_top = (
            uniform_filter1d(on_top, PIXELS, axis=axis, mode="wrap") + 0.6 * _round(2.0 * (across % 1.0) - 1.0)
            for on_top, across, axis in ((up, x, 0), (1.0 - up, y, 1))
        )
        height, warp = np.maximum(warp_top, weft_top), np.where(warp_top > weft_top, 1.0, 0.0)
    bright = np.where(warp > 0.5, warps, wefts) * (1.0 - CAVITY * (height.max() - height) / np.ptp(height))
    warp, height, bright = (part.astype(np.float32) for part in (warp, height, bright / bright.mean()))
    return warp, height, bright


def _round(x: Float) -> Float:
    """Return the height of a yarn of radius 1 at x from its axis."""
    return np.asarray(np.sqrt(np.maximum(1.0 - x * x, 0.0)))


def cloth_material(mi: Any, look: Look, colour: Any, unit: tuple[float, float] | None, pixel: float) -> dict[str, Any]:
    """Return the material of a cloth of a colour, a texture of Mitsuba, of which yarns vary one that is plain.

    unit   length [m] of a unit of u and of v, None for cloth without texture coordinates, which shows no yarns
    pixel  side of a pixel at the cloth [m]: finer yarns are drawn by their mean, which has no grain

    The dull part scatters and, where it is thin, transmits light, with sheen. The surface of yarns reflects in two
    lobes, narrow along warp and along weft, each where its yarns are on top.
    """
    on_top, height, bright = draw_tile(look.weave, look.slub)
    seen = min(max(PERIODS[look.weave] * look.pitch / pixel - 1.5, 0.0), 1.0) if unit else 0.0
    plain = np.asarray(colour["value"] if colour["type"] == "rgb" else (0.6, 0.6, 0.6), np.float64)

    def texture(values: NDArray[np.float32]) -> dict[str, Any]:
        scale = mi.ScalarTransform4f().scale([side / (YARNS * look.pitch) for side in unit or ()] + [1.0])
        return {"type": "bitmap", "bitmap": mi.Bitmap(np.atleast_3d(values)), "raw": True, "to_uv": scale}

    if seen and colour["type"] == "rgb":
        # Some of the weft's colour is white; the mean of all yarns stays.
        warp = float(on_top.mean())
        white = plain + look.weft * (0.8 - plain)
        dyed = np.maximum((plain - (1.0 - warp) * white) / max(warp, 0.1), 0.3 * plain)
        yarns = np.where(on_top[..., None] < 0.5, white, dyed) * bright[..., None]
        colour = texture(np.clip(plain + seen * (yarns - plain), 0.0, 1.0).astype(np.float32))
    scatter = {
        "type": "principledthin", "base_color": colour, "roughness": 0.7, "spec_trans": 0.0, "sheen": look.sheen,
        "sheen_tint": 0.5, "diff_trans": look.thin,
    }  # fmt: skip
    ends = {"weft": (look.along, look.across), "warp": (look.across, look.along)}
    lobes = {
        name: {"type": "roughconductor", "distribution": "ggx", "alpha_u": u, "alpha_v": v,
               "specular_reflectance": rgb(0.3 + 0.7 * plain)} for name, (u, v) in ends.items()
    }  # fmt: skip
    weight: Any = texture(on_top) if seen else float(on_top.mean())
    shine = {"type": "twosided", "one": {"type": "blendbsdf", "weight": weight, **lobes}}
    material = {"type": "blendbsdf", "weight": look.gloss, "dull": scatter, "shine": shine}
    if not seen:
        return material
    return {"type": "bumpmap", "height": texture(height), "scale": RELIEF * look.pitch * seen, "one": material}


def rgb(colour: Float) -> dict[str, Any]:
    """Return one colour (3,) as a texture of Mitsuba."""
    return {"type": "rgb", "value": [float(value) for value in colour]}


EACH = 16
"""Most paths a pixel in a pass, one in each cell of a grid, which halves the noise of independent ones. Noise is known
from the differences of two passes at least. A quarter as many rays find colours and normals for the denoiser, in passes
of this size, too: threads add up more rays of a pixel in any order."""
GUIDE = {"llvm_ad_rgb": 0.4, "scalar_rgb": 2.4}
"""Time of such a pass, in passes of paths, by Mitsuba's variant."""
PROBE, LEAST_PROBE = 0.1, 128
"""Width and height of the picture that tells how long the whole takes, as a share of its own; and the least of them
[pixels]: a smaller one takes as long, whatever it shows."""
MOST_PATHS, DEPTH = 2_000_000, 7
"""Paths between two looks at an interruption, and the most segments of a path: light reaches the inside of a skirt
after several."""
LLVM = 17
"""First version of LLVM that compiles Mitsuba's kernels: earlier ones end the process at `fminimum`."""
SKY_MAP = (512, 256)
"""Width and height of the map of the studio's light."""
FLAT, FILL = 0.5 * (SKY + GROUND) + (SKY - GROUND) / 3.0, 0.55
"""The raster renderer's light from all sides on a white floor, and the share of it here, where the floor throws light
back."""
ROUGH = 0.2
"""Roughness of the surface of fibres, as in the picture `yarns`."""
RINGS, AROUND, FAR = 48, 96, 5.0
"""Rings of the floor's vertices, vertices of each, and where it ends in the background's colour, in radii of the scene.
"""


class Paths:
    """Draws meshes by path tracing with Mitsuba 3, on all cores.

    Cloth is lit from both sides, shines along its yarns and lets light through where it is thin; one-sided meshes are
    closed bodies. Meshes, camera, floor and light are those of the renderer `raster`. Needs nuno[paths].
    """

    name: ClassVar[str] = "paths"
    Config: ClassVar[type[BaseModel]] = PathsConfig

    def require(self) -> None:
        """Raise BadInput if Mitsuba is not installed."""
        if importlib.util.find_spec("mitsuba") is None:
            problem, remedy = "the renderer paths needs Mitsuba, which is not installed", 'pip install "nuno[paths]"'
            raise BadInput(problem, field="--renderer", value="paths", remedy=f"{remedy}, or leave --renderer out")

    def render(self, config: BaseModel, meshes: list[Mesh], camera: Camera) -> NDArray[np.uint8]:
        """Return a picture (height, width, 3) uint8 sRGB. Raises BadInput as `passes`."""
        *_, last = self.passes(config, meshes, camera)
        assert last.picture is not None
        return last.picture

    def passes(self, config: BaseModel, meshes: list[Mesh], camera: Camera) -> Iterator[Pass]:
        """Draw in passes; the last has the picture. The same input and seed give the same bytes on one machine.

        Raises BadInput for arrays of the wrong shape, face indices out of range, a camera without size, field of view
        or direction, and without Mitsuba.
        """
        assert isinstance(config, PathsConfig)
        self.require()
        mi, how = load_mitsuba()
        stage = set_stage(mi, config, meshes, camera)
        tracer = mi.load_dict({"type": "path", "max_depth": DEPTH, "hide_emitters": True})
        number = min(max(-(-config.samples // EACH), 2), config.samples)
        samples, (width, height) = -(-config.samples // number), camera.size
        bands = min(max(1, -(-width * height * samples // MOST_PATHS)), height)
        parts, guides = number * bands, -(-number // 4)
        each, compiled = _probe(stage, camera, tracer, samples)
        yield Pass(0, parts, how, each * (number + GUIDE[how] * guides) + compiled * bands)
        sensors = [stage.look(camera, *rows) for rows in pairwise(round(k * height / bands) for k in range(bands + 1))]
        sums = np.zeros((2, height, width, 3))
        squares = np.zeros_like(sums[0])
        for k in range(number):
            drawn = []
            for i, sensor in enumerate(sensors):
                seed = (config.seed * 65537 + k * len(sensors) + i) % 2**32
                drawn.append(stage.render(sensor, tracer, samples, seed))
                yield Pass(k * len(sensors) + i + 1, parts, how)
            seen = np.concatenate(drawn)
            light = stage.lay_over(seen)
            sums[k % 2] += light
            squares += light**2
        picture = sums.sum(axis=0) / number
        noise = _relative(np.maximum(squares / number - picture**2, 0.0) / max(number - 1, 1), picture)
        wanted = config.denoise and number > 1
        if wanted and (denoise := _denoiser(stage, sensors, 1.0 - seen[..., 3:], guides)) is not None:
            how = f"{how}, {noise:.2%} before Open Image Denoise"
            even, odd = denoise(sums[0] / ((number + 1) // 2)), denoise(sums[1] / (number // 2))
            picture = denoise(picture)
            noise = _relative((0.5 * (even - odd)) ** 2, picture)
        encoded = annotate(encode_picture(picture), config.caption, config.legend)
        yield Pass(parts, parts, how, 0.0, noise if number > 1 else math.nan, encoded)


def load_mitsuba() -> tuple[Any, str]:
    """Import Mitsuba, and choose its variant: by LLVM, which takes a quarter of the processor's time (14 s instead of
    54 s for skirt-hula, 960 x 720, 64 paths a pixel), where a version is found that compiles it; else the one that
    needs nothing else. Return the module and the variant's name.
    """
    import drjit
    import mitsuba as mi

    found = 0
    with suppress(ImportError, RuntimeError, AttributeError):
        mi.set_variant("llvm_ad_rgb")
        drjit.eval(drjit.arange(mi.Float, 1))
        found = drjit.detail.llvm_version()[0]
    mi.set_variant(how := "llvm_ad_rgb" if found >= LLVM else "scalar_rgb")
    mi.set_log_level(mi.LogLevel.Error)
    return mi, how


def _probe(stage: Stage, camera: Camera, tracer: Any, samples: int) -> tuple[float, float]:
    """Return about how long a pass takes, and how much longer the first one of each band, which compiles its kernels
    [s], by a small picture.
    """
    share = min(max(PROBE, LEAST_PROBE / min(camera.size)), 1.0)
    width, height = (max(round(side * share), 1) for side in camera.size)
    sensor = stage.look(replace(camera, size=(width, height)), 0, height)
    times = [time.perf_counter()]
    for _ in range(2):
        stage.render(sensor, tracer, samples, 0)
        times.append(time.perf_counter())
    first, second = np.diff(times).tolist()
    return second / share**2, max(first - second, 0.0)


def _relative(variance: Float, picture: Float) -> float:
    """Return the root of a picture's mean variance (h, w, 3), relative to its mean light."""
    return math.sqrt(float(variance.mean())) / (float(picture.mean()) or 1.0)


def _denoiser(stage: Stage, sensors: list[Any], empty: Float, guides: int) -> Callable[[Float], Float] | None:
    """Return a function that takes noise from a picture (h, w, 3), by Open Image Denoise with the colours and normals
    of surfaces, from so many passes; None where it is not installed. The background, of a share `empty` (h, w, 1), is
    to it a floor, so that the floor's end is no edge.
    """
    try:
        import pyoidn
    except (ImportError, OSError):
        return None
    guide = stage.mi.load_dict({"type": "aov", "aovs": "albedo:albedo,normal:sh_normal"})
    rows = [[stage.render(one, guide, EACH, guides * i + k) for k in range(guides)] for i, one in enumerate(sensors)]
    drawn = np.concatenate([np.mean(parts, axis=0) for parts in rows])[..., -6:]
    albedo = (drawn[..., :3] + empty * stage.fading((np.arange(len(drawn)) + 0.5) / len(drawn))[:, None]).astype(
        np.float32
    )
    normal = (drawn[..., 3:] + empty * stage.up).astype(np.float32)

    def denoise(picture: Float) -> Float:
        return np.asarray(pyoidn.denoise(picture.astype(np.float32), albedo, normal, hdr=True), np.float64)

    return denoise


# The scene: meshes, a floor, studio light and the camera, for Mitsuba.


@dataclass
class Stage:
    """Mitsuba's scene of a picture, about the camera's target; up and key (3,): unit vectors away from the floor and
    toward the key light.
    """

    mi: Any
    scene: Any
    drawn: DrawnScene
    ground: Ground
    sight: Sight
    up: Float
    key: Float

    def render(self, sensor: Any, integrator: Any, samples: int, seed: int) -> Float:
        """Return what a sensor sees (h, w, channels)."""
        try:
            seen = self.mi.render(self.scene, sensor=sensor, integrator=integrator, spp=samples, seed=seed)
        except RuntimeError as error:
            if isinstance(error.__cause__ or error.__context__, KeyboardInterrupt):  # as Dr.Jit passes it on
                raise KeyboardInterrupt from None
            raise
        return np.asarray(np.array(seen, np.float64))

    def look(self, camera: Camera, first: int, last: int) -> Any:
        """Return a sensor for rows first up to last of a picture: linear light, and the share of surfaces in it."""
        eye, distance = self.sight.eye, float(np.linalg.norm(self.sight.eye))
        film = {
            "type": "hdrfilm", "width": camera.size[0], "height": camera.size[1], "pixel_format": "rgba",
            "crop_offset_x": 0, "crop_offset_y": first, "crop_width": camera.size[0], "crop_height": last - first,
            "component_format": "float32", "rfilter": {"type": "box"},
        }  # fmt: skip
        return self.mi.load_dict({
            "type": "perspective", "fov": math.degrees(camera.fov), "fov_axis": "y", "film": film,
            "to_world": self.mi.ScalarTransform4f().look_at(eye.tolist(), [0.0, 0.0, 0.0], self.sight.up.tolist()),
            "near_clip": 1e-3 * distance, "far_clip": 1e3 * (self.drawn.radius + distance),
            "sampler": {"type": "multijitter"},
        })  # fmt: skip

    def background(self, down: Float) -> Float:
        """Return the raster renderer's background (n, 3) at shares `down` (n,) of the picture's height."""
        s = np.clip(down, 0.0, 1.0)
        s = s * s * (3.0 - 2.0 * s)
        return np.asarray(self.ground.top + s[:, None] * (self.ground.bottom - self.ground.top))

    def fading(self, down: Float) -> Float:
        """Return the colour (n, 3) of a floor that looks like the background at shares `down` of the height."""
        return np.asarray(np.minimum(self.background(down) / (KEY * max(float(self.up @ self.key), 0.0) + FLAT), 1.0))

    def lay_over(self, light: Float) -> Float:
        """Lay light (h, w, 4), whose last channel is the share of surfaces, over the background. Return (h, w, 3)."""
        behind = self.background((np.arange(len(light)) + 0.5) / len(light))[:, None]
        return np.asarray(light[..., :3] + (1.0 - light[..., 3:]) * behind)


def set_stage(mi: Any, config: PathsConfig, meshes: list[Mesh], camera: Camera) -> Stage:
    """Return the scene of meshes as a camera sees them. Raises BadInput as the renderer."""
    sight, up, origin = sight_of(camera), unit(np.array(config.up)), np.asarray(camera.target, np.float64)
    meshes = refine(meshes, camera)
    drawn = gather(meshes, origin, up)
    lowest = drawn.lowest if len(drawn.faces) else math.inf
    ground = find_ground(config, lowest, origin, sight.eye, up, drawn.centre, drawn.radius)
    stage = Stage(mi, None, drawn, ground, sight, up, key_direction(config, camera, up))
    parts = {"type": "scene", "light": light_studio(stage, config.light_size)}
    if ground.active:
        parts["floor"] = lay_floor(stage, camera.size[1])
    for number, mesh in enumerate(meshes):
        if len(faces := drawn.faces[drawn.mesh == number]):
            parts[f"mesh{number}"] = shape_of(stage, faces, mesh, float(np.linalg.norm(sight.eye)) / sight.focal)
        parts |= {f"yarns{number}-{k}": shape for k, shape in enumerate(yarn_shapes(mi, mesh, origin))}
    stage.scene = mi.load_dict(parts)
    return stage


def light_studio(stage: Stage, size: float) -> dict[str, Any]:
    """Return the light around a scene: sky and floor by height, and a round key light, as large as `size` says and so
    bright that the floor has the raster renderer's light.
    """
    width, height = SKY_MAP
    polar = (np.arange(height)[:, None] + 0.5) / height * np.pi
    turn = (np.arange(width)[None] + 0.5) / width * 2.0 * np.pi
    toward = np.stack([np.sin(turn) * np.sin(polar), np.cos(polar) + 0.0 * turn, -np.cos(turn) * np.sin(polar)], -1)
    light = FILL * (0.5 * (SKY + GROUND) + 0.5 * (SKY - GROUND) * (toward @ stage.up)[..., None])
    # A disc with a soft edge; its light is scaled by that which the map's pixels throw on a wall that faces it.
    spread, facing = math.atan(max(size, 0.02)), toward @ stage.key
    disc = np.clip((spread - np.arccos(np.clip(facing, -1.0, 1.0))) / (0.25 * spread) + 0.5, 0.0, 1.0)
    thrown = float((disc * np.maximum(facing, 0.0) * np.sin(polar)).sum()) * 2.0 * np.pi / (width * height)
    slope = float(stage.up @ stage.key)
    light += disc[..., None] * (KEY + ((1.0 - FILL) * FLAT / slope if slope > 0.2 else 0.0)) / thrown
    return {"type": "envmap", "bitmap": stage.mi.Bitmap(light.astype(np.float32))}


def lay_floor(stage: Stage, height: int) -> Any:
    """Return the floor. With distance, as the raster renderer's fades, it takes on the colour that the background has
    there in the picture, in the light that falls on it where nothing is near; so it ends without an edge.

    Rejected: transparency with distance (`mask`), which in Mitsuba loses light.
    """
    distance = np.linspace(0.0, FAR, RINGS)
    turn = np.arange(AROUND) * 2.0 * np.pi / AROUND
    u, v, _ = tangents(stage.up) * stage.ground.radius
    along = np.cos(turn)[:, None] * u + np.sin(turn)[:, None] * v
    x = (stage.ground.centre + distance[:, None, None] * along).reshape(-1, 3)
    sight = stage.sight
    ahead, rise = (x - sight.eye) @ sight.forward, (x - sight.eye) @ sight.up
    down = np.where(ahead > 0.0, 0.5 - sight.focal / height * rise / np.where(ahead > 0.0, ahead, 1.0), 1.0)
    fade = np.repeat(np.clip((distance - 1.0) / (FAR - 1.0), 0.0, 1.0), AROUND)[:, None]
    fade = fade * fade * (3.0 - 2.0 * fade)
    ring, step = np.meshgrid(np.arange(RINGS - 1) * AROUND, np.arange(AROUND), indexing="ij")
    a, b = (ring + step).ravel(), (ring + (step + 1) % AROUND).ravel()
    faces = np.concatenate([np.stack([a, a + AROUND, b + AROUND], 1), np.stack([a, b + AROUND, b], 1)])
    dull = {"type": "diffuse", "reflectance": {"type": "mesh_attribute", "name": "vertex_color"}}
    colours = (1.0 - fade) * stage.ground.albedo + fade * stage.fading(down)
    return make_mesh(stage.mi, faces, {"type": "twosided", "one": dull}, vertex_positions=x, vertex_color=colours)


def shape_of(stage: Stage, faces: NDArray[np.int32], mesh: Mesh, pixel: float) -> Any:
    """Return the shape of one of a scene's meshes, with its material; pixel: a pixel's side at the cloth [m]."""
    mi, drawn = stage.mi, stage.drawn
    used, inverse = np.unique(faces, return_inverse=True)
    colours, x, uv, triangles = drawn.albedo[used], drawn.positions[used], drawn.uv[used], inverse.reshape(-1, 3)
    plain = bool((colours == colours[0]).all())
    colour: Any = rgb(colours[0]) if plain else {"type": "mesh_attribute", "name": "vertex_color"}
    if mesh.image is not None and mesh.uv is not None:
        colour = {"type": "bitmap", "bitmap": mi.Bitmap(np.array(mesh.image)), "wrap_mode": "repeat"}
    if mesh.two_sided:
        look = LOOKS.get(mesh.material, Look())
        material = cloth_material(mi, look, colour, unit_lengths(x, uv, triangles), pixel)
    else:  # skin, which the light that scatters in it flattens, or painted wood
        finish = (0.45, 0.35, 0.8) if mesh.material == SKIN else (0.55, 0.25, 0.0)
        material = dict(zip(("roughness", "specular", "flatness"), finish, strict=True))
        material = {"type": "twosided", "one": {"type": "principled", "base_color": colour, **material}}
    rows = {"vertex_positions": x, "vertex_normals": drawn.normals[used], "vertex_texcoords": uv}
    return make_mesh(mi, triangles, material, **rows, **({} if plain else {"vertex_color": colours}))


def yarn_shapes(mi: Any, mesh: Mesh, origin: Float) -> Iterator[Any]:
    """Yield the yarns of a mesh with finite points, those of one colour as one shape. Mitsuba's `hair` has the lobes of
    `nuno_render.shading.fibre`.

    Rejected: `principled` with sheen, which takes an eighth less time for a stocking, but passes no light: its yarns
    hide the skin.
    """
    if (yarns := mesh.yarns) is None:
        return
    x, colours = np.asarray(mesh.vertices, np.float64) - origin, albedo_of(mesh)[yarns.ptr[:-1]]
    for colour in np.unique(colours, axis=0):
        curves = []
        for y in np.flatnonzero((colours == colour).all(axis=1)):
            p = x[yarns.ptr[y] : yarns.ptr[y + 1]]
            if len(p) > 1 and np.isfinite(p).all():
                # A B-spline goes nearly through its control points if they are dense; one more at each end lets it
                # begin and end at the yarn's ends, or closes a ring.
                ring = len(p) > 3 and (p[0] == p[-1]).all()
                ends = (p[-2], p[1]) if ring else (2.0 * p[0] - p[1], 2.0 * p[-1] - p[-2])
                rows = np.insert(np.stack([ends[0], *p, ends[1]]), 3, yarns.radius[y], axis=1)
                curves.append("\n".join("{:.9g} {:.9g} {:.9g} {:.9g}".format(*row) for row in rows.tolist()))
        material = {
            "type": "hair", "int_ior": NYLON, "scale_tilt": 0.0, "longitudinal_roughness": ROUGH,
            "azimuthal_roughness": ROUGH, "sigma_a": rgb(find_absorption(colour, ROUGH)),
        }  # fmt: skip
        with tempfile.TemporaryDirectory(prefix="nuno-") as folder:
            path = Path(folder, "yarns.txt")
            path.write_text("\n\n".join(curves))
            if curves:
                yield mi.load_dict({"type": "bsplinecurve", "filename": str(path), "bsdf": material})


def make_mesh(mi: Any, faces: NDArray[Any], material: dict[str, Any], **rows: Float) -> Any:
    """Return a mesh of Mitsuba from faces (f, 3) and its fields by name, one row a vertex."""
    props = mi.Properties()
    props["bsdf"] = mi.load_dict(material)
    count = len(rows["vertex_positions"])
    shape = mi.Mesh("mesh", count, len(faces), props, "vertex_normals" in rows, "vertex_texcoords" in rows)
    if "vertex_color" in rows:
        shape.add_attribute("vertex_color", 3, np.zeros(3 * count, np.float32))
    fields = mi.traverse(shape)
    fields["faces"] = np.ascontiguousarray(faces, np.uint32).ravel()
    for name, values in rows.items():
        fields[name] = np.ascontiguousarray(values, np.float32).ravel()
    fields.update()
    return shape


def unit_lengths(x: Float, uv: Float, faces: NDArray[Any]) -> tuple[float, float] | None:
    """Return the lengths [m] of a unit of u and of v: root mean squares over the triangles, weighted by their area in
    (u, v), of how far the surface goes along each. None without texture coordinates.
    """
    (a, b, c), (p, q, r) = np.take(x, faces.T, axis=0), np.take(uv, faces.T, axis=0)
    area = (q - p)[:, 0] * (r - p)[:, 1] - (q - p)[:, 1] * (r - p)[:, 0]
    laid = np.abs(area) > 1e-12
    if not laid.any():
        return None
    e, f, s, t, area = (part[laid] for part in (b - a, c - a, q - p, r - p, area[:, None]))
    ways = (t[:, 1:] * e - s[:, 1:] * f) / area, (s[:, :1] * f - t[:, :1] * e) / area
    u, v = (math.sqrt(float(np.average((way**2).sum(axis=1), weights=np.abs(area[:, 0])))) for way in ways)
    return (u, v) if math.isfinite(u) and math.isfinite(v) and min(u, v) > 0.0 else None
