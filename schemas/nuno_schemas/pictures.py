"""Pictures: meshes and cameras, and the plugins that draw them, dyed cloth, knits and drafts."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from nuno_schemas.dyeing import DyeColour, DyeView
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Bool, Float, Int
from nuno_schemas.layout import Bounds
from nuno_schemas.operation import YarnCurves
from nuno_schemas.plugin import Files, Plugin

# Pictures of dyed cloth: the data that they show, and the plugins that draw them.

Picture = NDArray[np.uint8]
"""(h, w, 3) sRGB."""


@dataclass(frozen=True)
class Photograph:
    """Photograph of a cloth, with a whole number of pixels k across each cell.

    light  (k ny, k nx, 3) uint8  sRGB
    warp   (k ny, k nx) bool      whether a pixel shows the warp (true) or the weft
    """

    light: NDArray[np.uint8]
    warp: Bool


@dataclass(frozen=True)
class Layers:
    """The visible properties of a cloth's cells, layer 0 the weft and layer 1 the warp.

    fibre  (2, ny, nx) bool    fibre (true) or gap
    up     (2, ny, nx) bool    whether the yarn is above the other layer's yarn
    v_max                      most dye that a cell holds; the fields below are for pictures only
    yarns  (ny,) and (nx,)     yarn of each row of weft, and of each column of warp; None if yarns are separated by
                               gaps alone
    photograph                 photograph of the cloth, or None
    ground (ny, 3), (nx, 3)    colour of the undyed yarns by row of weft and by column of warp, sRGB in [0, 1]; None
                               if unknown
    """

    fibre: Annotated[Bool, 2, "ny", "nx"]
    up: Annotated[Bool, 2, "ny", "nx"]
    v_max: Annotated[float, Bounds(above=0.0)] = field(default=1.0, kw_only=True)
    yarns: tuple[Annotated[Int, "ny", Bounds(0)], Annotated[Int, "nx", Bounds(0)]] | None = field(
        default=None, kw_only=True
    )
    photograph: Photograph | None = field(default=None, kw_only=True)
    ground: tuple[Float, Float] | None = field(default=None, kw_only=True)


class Window(NamedTuple):
    """Cells shown in a picture: rows top to bottom, columns left to right, bottom and right excluded."""

    top: int
    bottom: int
    left: int
    right: int


def amount_seen(phi: Float, fixed: Float, view: DyeView = "all") -> Float:
    """Return the amount shown in a view: all dye, fixed dye, or mobile dye."""
    return {"all": phi + fixed, "fixed": fixed, "mobile": phi}[view]


class DyePicturePlugin(Plugin, Protocol):
    """Draws dyed cloth."""

    def prepare(
        self, config: Any, files: Files, layers: Layers, dyes: Sequence[DyeColour], window: Window, scale: int
    ) -> Any:
        """Return data shared by all pictures of the window at `scale` pixels per cell. Raises BadInput."""
        ...

    def draw(self, prepared: Any, amounts: Float) -> Picture:
        """Return a picture, shape (scale (bottom - top), scale (right - left), 3), of the whole cloth's amounts
        (dyes, 2, ny, nx).
        """
        ...


# A weaver's draft as a picture, as a plugin of `nuno.dye_cloths` with a method `draw_draft(path)` returns it.


@dataclass(frozen=True)
class DrawnDraft:
    """A draft with its drawdown.

    picture   (h, w, 3) sRGB
    pixel     side of a pixel of the drawdown [m], None if the file has no spacing
    facts     properties that the file states, as text by name
    drawdown  (picks, ends), True where the warp is above
    """

    picture: Picture
    pixel: float | None
    facts: Mapping[str, str]
    drawdown: Bool


# Renderers: plugins that draw meshes as a camera sees them.

SKIN = "skin"
"""Material of a body that is a person's."""


@dataclass(frozen=True)
class Mesh:
    """Something to draw: vertices (n, 3) [m], faces (f, 3), colours (n, 3) float in [0, 1]
    linear or None, uv (n, 2) and image (h, w, 3) uint8 or None; material: the name of a cloth's fabric, or SKIN, for
    renderers that draw what they know of it; normals (n, 3) of length 1, or None for those of the faces; yarns: curves
    through the vertices, which stand for their points, for renderers that draw them.
    """

    vertices: Float
    faces: NDArray[np.int32]
    colours: NDArray[np.float64] | None = None
    uv: NDArray[np.float32] | None = None
    image: NDArray[np.uint8] | None = None
    two_sided: bool = True
    material: str = ""
    normals: Float | None = None
    yarns: YarnCurves | None = None


@dataclass(frozen=True)
class Camera:
    """eye, target, up (3,) [m]; vertical field of view [rad]; size (width, height) [pixels]."""

    eye: Float
    target: Float
    up: Float
    fov: float
    size: tuple[int, int]


class Renderer(Plugin, Protocol):
    """Draws meshes."""

    def render(self, config: Any, meshes: list[Mesh], camera: Camera) -> NDArray[np.uint8]:
        """Return a picture (height, width, 3) uint8 sRGB."""
        ...


@dataclass(frozen=True)
class Pass:
    """A part of the work on a picture: `done` of `total`, 0 before the first, which knows about how long all take.

    how      by what it is drawn, for the user;  left  time that the work takes [s]
    noise    standard error of the picture's light, relative to its mean; NaN while unknown
    picture  in the last one: (height, width, 3) uint8 sRGB
    """

    done: int
    total: int
    how: str
    left: float = math.nan
    noise: float = math.nan
    picture: Picture | None = None


@runtime_checkable
class Progressive(Protocol):
    """A renderer that takes long, and draws in parts, between which it can be interrupted."""

    def require(self) -> None:
        """Raise BadInput if something that the renderer needs is not installed."""
        ...

    def passes(self, config: Any, meshes: list[Mesh], camera: Camera) -> Iterator[Pass]:
        """Yield the parts of the work; the last has the picture that `render` returns."""
        ...


# Camera fitting, for all renderers and viewers.

Axes = tuple[Float, Float, Float]


def axes(camera: Camera) -> Axes:
    """Return the unit vectors right, up and forward of a camera, each (3,).

    Raises BadInput if eye and target coincide, or `up` is parallel to the line of sight.
    """
    forward = np.asarray(camera.target, np.float64) - np.asarray(camera.eye, np.float64)
    length = float(np.linalg.norm(forward))
    if not (math.isfinite(length) and length > 0.0):
        raise BadInput("the camera's eye and target must be finite and apart", field="camera.eye", value=camera.eye)
    forward = forward / length
    right = np.cross(forward, np.asarray(camera.up, np.float64))
    width = float(np.linalg.norm(right))
    if not width > 1e-9:
        raise BadInput("the camera's up vector is parallel to its line of sight", field="camera.up", value=camera.up)
    right = right / width
    return right, np.cross(right, forward), forward


def frame(
    points: NDArray[np.floating] | Iterable[Mesh],
    azimuth: float = 0.6,
    elevation: float = 0.25,
    size: tuple[int, int] = (960, 720),
    fov: float = 0.5,
    margin: float = 0.08,
) -> Camera:
    """Fit a camera to all points, with z up.

    points     (n, 3) [m], or meshes; non-finite points are left out. For an animation, pass
               the points of several frames, so that the camera stands still
    azimuth    direction of the camera [rad], counter-clockwise seen from above; 0 is on the
               -y side and looks along +y
    elevation  its height above the horizon [rad], -pi/2 to pi/2
    size       (width, height) [pixels];  fov vertical field of view [rad]
    margin     part of the picture left free on each side, 0 to 0.45

    The fit is exact: the cloud touches the margin on two opposite sides. Raises BadInput for
    an argument out of range.
    """
    if not (0.01 <= fov <= 2.8 and 0.0 <= margin <= 0.45 and min(size) >= 1):
        limit = "fov 0.01 to 2.8 rad, margin 0 to 0.45, size at least 1"
        raise BadInput("the camera cannot be fitted", field="camera", value=(fov, margin, size), limit=limit)
    cloud = _cloud(points)
    flat = math.cos(elevation)
    toward = np.array([math.sin(azimuth) * flat, -math.cos(azimuth) * flat, math.sin(elevation)])
    right = np.array([math.cos(azimuth), math.sin(azimuth), 0.0])
    forward, up = -toward, np.cross(toward, right)
    middle = (cloud.min(axis=0) + cloud.max(axis=0)) / 2.0
    spread = float(np.linalg.norm(cloud.max(axis=0) - cloud.min(axis=0)))
    scale = spread if spread > 0.0 else 1.0
    x, y, z = ((cloud - middle) @ np.stack([right, up, forward], axis=1)).T
    half = math.tan(fov / 2.0) * (1.0 - 2.0 * margin)
    a, back_x = _fit(x, z, half * size[0] / size[1])
    b, back_y = _fit(y, z, half)
    back = max(back_x, back_y, float(-z.min()) + 0.05 * scale)
    eye = middle + a * right + b * up - back * forward
    return Camera(eye, eye + back * forward, up, fov, size)


def _cloud(points: NDArray[np.floating] | Iterable[Mesh]) -> Float:
    """Return the finite points, shape (n, 3), or those of a unit cube if there are none."""
    parts = [points] if isinstance(points, np.ndarray) else [mesh.vertices for mesh in points]
    cloud = np.concatenate([np.zeros((0, 3)), *(np.asarray(part, np.float64).reshape(-1, 3) for part in parts)])
    cloud = cloud[np.isfinite(cloud).all(axis=1)]
    return cloud if len(cloud) else np.array([[-0.5, -0.5, -0.5], [0.5, 0.5, 0.5]])


def _fit(x: Float, z: Float, k: float) -> tuple[float, float]:
    """Return the sideways position and the distance back of an eye that sees all (x, z) within slope k.

    An eye at (a, -d) sees a point where |x - a| <= k (z + d), so x - k z <= a + k d and
    -x - k z <= -a + k d for all points. With P and M the largest left sides, the smallest d
    has both equal: k d = (P + M) / 2 and a = (P - M) / 2.
    """
    p, m = float(np.max(x - k * z)), float(np.max(-x - k * z))
    return (p - m) / 2.0, (p + m) / (2.0 * k)


# Pictures of knits on bodies: the data that they show, and the plugins that draw them.

Progress = Callable[[int, int], None]
"""Called with the number of drawn rows and of all rows."""


@dataclass(frozen=True)
class SurfaceValues:
    """Numbers shown as colours on bodies.

    values (n,)  values of the worn points, or of the vertices or faces of all bodies in their order; NaN: no value
    label        name of the quantity, with its unit
    """

    on: Literal["points", "vertices", "faces"]
    values: Float
    label: str


@dataclass(frozen=True)
class Worn:
    """Knits and the bodies that wear them, z up.

    bodies          meshes, closed if they are one-sided; a body without colours has the colour of skin
    points (n, 3)   crossings of yarns, the paper's mass points [m]
    links  (l, 2)   int32, end points of each link of yarn
    yarns           yarns as curves; None for a plugin that draws none
    values          values to show; None for a plugin that shows none
    """

    bodies: tuple[Mesh, ...]
    points: Float
    links: Int
    yarns: YarnCurves | None = None
    values: SurfaceValues | None = None


class YarnPicture(Plugin, Protocol):
    """Draws knits on bodies."""

    curves: ClassVar[bool]
    """Whether it draws yarns as curves, which are slow to make."""
    shows: ClassVar[bool]
    """Whether it shows values from the caller: for knits in recordings, their pressure."""

    def draw(self, config: Any, worn: Worn, camera: Camera, progress: Progress | None = None) -> Picture:
        """Return a picture (height, width, 3) uint8 sRGB, the same bytes for any number of threads.

        Raises BadInput if the eye is inside a body, yarns have no thickness, or there is nothing to draw.
        """
        ...
