"""Pictures and animations of a recording, drawn without a screen."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ValidationError

from nuno.exports.camera import of_camera, place_camera, read_view, turn, turned, z_up
from nuno.exports.cloth import (
    BODY,
    SIDES,
    STRETCH,
    Pieces,
    Pressures,
    ShownBodies,
    ShownPiece,
    body_vertices,
    check_size,
    coloured,
    paint_pressure,
    read_bodies,
    read_frame,
    read_pressure,
    tubes,
)
from nuno.exports.dyed_pictures import Changes, dyed_pictures, find_amounts, read_dyed_object
from nuno.exports.meshes import paint_piece
from nuno.formatting import duration, many, roughly
from nuno.output_files import Progress, check_target, following, write_png
from nuno.plugin_contract import registry
from nuno.recording.reader import Recording, opened
from nuno.recording.recorded import Frame
from nuno.scene.validation_errors import explain
from nuno_schemas.colour import parse_hex, to_linear, to_srgb
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float
from nuno_schemas.pictures import SKIN, Mesh, Progressive

Picture = NDArray[np.uint8]
Colour = Literal["auto", "cloth", "stretch", "pressure"]
"""Paint of cloth. cloth: its texture, else its colour, else the colours of its kinds of yarn, else plain; stretch: the
stretch of its threads; pressure: the pressure of a knit; auto: by `view.colour`, and links of nets by stretch."""
RENDERER = "raster"
SKIN_COLOUR = "#d6a184"
"""Colour of persons in pictures by renderers that draw skin."""
ROOM = 0.04
"""Additional free margin on each side of a picture with a legend, as a share of it."""
MOST_PICTURES = 1_000_000
MOMENTS = 8
"""Moments whose mean is a picture with a shutter."""
LOOKS = 16
"""Number of frames to which the camera of an animation is fitted."""


@dataclass(frozen=True)
class Rendering:
    """By what pictures are drawn: a renderer, its samples a pixel or None, and what takes lines for the user."""

    renderer: str = RENDERER
    samples: int | None = None
    tell: Callable[[str], None] = lambda _: None

    def load(self) -> Any:
        """Return the renderer. Raises BadInput for an unknown one, one that is not installed, and its samples."""
        settings = {} if self.samples is None else {"samples": self.samples}
        try:
            plugin = registry.load("nuno.renderers", self.renderer)
            if isinstance(plugin, Progressive):
                plugin.require()
            plugin.Config(**settings)
        except BadInput as error:
            raise replace(error, field="--renderer", value=self.renderer) from None
        except ValidationError as error:
            limit = explain(error, settings, (), "", {}, plugin.Config).limit
            problem = f"{self.renderer} does not draw so many samples a pixel"
            raise BadInput(problem, field="--samples", value=self.samples, limit=limit) from None
        return plugin


PLAIN_RENDERING = Rendering()


@dataclass
class Painter:
    """Draws frames of one recording with one camera.

    Pictures show cloth painted by `colour`, bodies in grey, the scene's name and the time.
    The scene's view chooses the camera, and its omitted fields are fitted to `shown`. Raises
    BadInput for a recording without cloth, and for an unknown `colour`.
    """

    recording: Recording
    shown: list[Frame]
    size: tuple[int, int] | None = None
    options: dict[str, Any] = field(default_factory=dict)
    """Settings of the renderer, e.g. samples."""
    colour: Colour = "auto"
    changes: Changes | None = None
    """Changes of the scene's camera, and of dye on an object."""
    rendering: Rendering = PLAIN_RENDERING
    number: int = 1
    """How many pictures will be drawn, by which a slow renderer estimates its time."""

    def __post_init__(self) -> None:
        check_colour(self.colour)
        self._curves: tuple[int, Mesh] | None = None
        self.cloth = Pieces(self.recording)
        self.bodies: ShownBodies | None = read_bodies(self.recording)
        measured = self.colour in ("stretch", "pressure")
        changes = self.changes or Changes()
        self.renderer = self.rendering.load()
        slow = isinstance(self.renderer, Progressive)
        self.knit = slow and not measured and "edge_yarn" in self.recording.fabric()[0]
        self.of_yarns = tuple(item for item in changes.overrides if self.knit and item.startswith("view.yarns"))
        others = [item for item in changes.overrides if item not in self.of_yarns]
        camera, of_dye = of_camera(self.recording, others)
        self.dyed = None if measured else read_dyed_object(self.recording, replace(changes, overrides=of_dye))
        self.pressure = require_pressure(self.recording) if self.colour == "pressure" else None
        self.most = 1.0
        if self.pressure is not None:  # the largest 95th percentile [Pa]: edges and closed toes have far more
            finite = (frame.x for frame in self.shown if np.isfinite(frame.x).all())
            self.most = max((float(np.percentile(self.pressure(x), 95.0)) for x in finite), default=0.0) or 1.0
        if self.rendering.samples is not None or slow:
            self.options = {} if self.rendering.samples is None else {"samples": self.rendering.samples}
        self.fabrics, self.persons = name_materials(self.recording.scene)
        self.view = read_view(self.recording, camera)
        self.ground = self._ground([mesh for frame in self.shown for mesh in self._plain(frame)])
        dyed = "" if self.dyed is None else self.dyed.name
        first = self.pieces(self.shown[0].t if self.shown else 0.0)
        plain = [p for p in first if p.image is None and p.colour is None and p.name != dyed]
        by_stretch = not self.knit and any(len(piece.edges) and piece.yarns is None for piece in plain)
        legend = {"label": "stretch (log scale)", "low": STRETCH[0], "high": STRETCH[1], "format": "percent"}
        self.legend = legend if by_stretch else None
        if self.pressure is not None:
            self.legend = {"label": "pressure [Pa]", "low": 0.0, "high": self.most}
        size = self.size or self.view.size
        fitted = [mesh for frame in self.shown for mesh in self._fitted(frame)]
        self.camera = place_camera(self.view, fitted, size, ROOM if self.legend else 0.0)

    def stand_back(self, frame: Frame) -> None:
        """Fit the camera so that the frame is in the picture from every side, whatever the view's target."""
        meshes = self._fitted(frame)
        points = np.concatenate([mesh.vertices for mesh in meshes])
        middle = 0.5 * (points.min(axis=0) + points.max(axis=0)) * [1.0, 1.0, 0.0]
        around = [replace(mesh, vertices=turn(mesh.vertices - middle, angle) + middle)
                  for mesh in meshes for angle in 2.0 * np.pi * np.arange(LOOKS) / LOOKS]  # fmt: skip
        view = self.view.model_copy(update={"target": None, "distance": None})
        self.camera = place_camera(view, around, self.camera.size, ROOM if self.legend else 0.0)

    def draw(
        self, frame: Frame, angle: float = 0.0, progress: Progress | None = None, meshes: list[Mesh] | None = None
    ) -> Picture:
        """Draw a frame, or these meshes of it, (h, w, 3) uint8 sRGB, with the eye rotated about the vertical by an
        angle [rad]. Raises BadInput for a frame that a slow renderer would draw without cloth.
        """
        name = self.recording.metadata.get("run", {}).get("scene") or str(self.recording.scene.get("name", ""))
        caption = f"{name}   t = {frame.t:.2f} s"
        config: BaseModel = self.renderer.Config.model_validate(
            {"caption": caption, "legend": self.legend, "ground": self.ground, **self.options}
        )
        meshes, camera = meshes or self.meshes(frame), turned(self.camera, angle)
        if not isinstance(self.renderer, Progressive):
            return np.asarray(self.renderer.render(config, meshes, camera))
        tell, started, pieces = self.rendering.tell, time.perf_counter(), self.pieces(frame.t)
        parts = [(frame.x[one.start : one.stop], one.faces if len(one.faces) else one.edges) for one in pieces]
        if not any(np.isfinite(x[corners]).all(axis=(1, 2)).any() for x, corners in parts):
            problem, remedy = "there is no cloth to draw in this frame", "choose another, or leave --renderer out"
            raise BadInput(problem, str(self.recording.path), field="--frame", value=frame.number, remedy=remedy)
        for part in self.renderer.passes(config, meshes, camera):
            if part.done == 0 and self.number:
                tell(f"{part.how}: {roughly(part.left * self.number)} for {many(self.number, 'picture')}")
                self.number = 0
            elif part.picture is None and progress is not None:
                progress(part.done, part.total)
        assert part.picture is not None
        took = duration(time.perf_counter() - started)
        noise = "unknown" if math.isnan(part.noise) else f"{part.noise:.2%} of its light"
        tell(f"frame {frame.number}: {part.how}; noise {noise}, in {took}")
        return part.picture

    def blur(self, frame: Frame, seconds: float) -> Picture:
        """Draw what a shutter sees that is open for so long from a frame on: the mean light of MOMENTS within."""
        after = seconds / MOMENTS * (np.arange(MOMENTS) + 0.5)
        pictures = [self.draw(frame, meshes=self._meshes_at(frame, frame.t + float(step))) for step in after]
        light = np.mean([to_linear(picture / 255.0) for picture in pictures], axis=0)
        return np.rint(to_srgb(light) * 255.0).astype(np.uint8)

    def _meshes_at(self, start: Frame, t: float) -> list[Mesh]:
        """Return the meshes at a time after a frame, on the straight way from the last frame before it to the next; the
        last frame's own after it, or where cloth was changed between the two.
        """
        source = self.recording
        *_, before = source.frames(start.t, t)
        frames = [before, *islice(source.frames(t), 1)]
        first, last = (self.meshes(frame) for frame in (frames[0], frames[-1]))
        s = 0.0 if len(frames) < 2 else (t - frames[0].t) / (frames[1].t - frames[0].t)
        if [len(mesh.vertices) for mesh in first] != [len(mesh.vertices) for mesh in last]:
            return first
        return [replace(a, vertices=(1.0 - s) * a.vertices + s * b.vertices) for a, b in zip(first, last, strict=True)]

    def pieces(self, t: float) -> list[ShownPiece]:
        """Return the cloth at t [s], ready for painting."""
        return [coloured(piece, self.colour) for piece in self.cloth.at(t)]

    def meshes(self, frame: Frame) -> list[Mesh]:
        """Return all meshes of a frame, rotated to z up, for the renderer, which may draw yarns as curves."""
        if not self.knit or not np.isfinite(frame.x).all():
            return self._plain(frame)
        if self._curves is None or self._curves[0] != frame.number:
            from nuno.exports.yarns import read_curves  # models of cloth, for which other pictures have no use

            self._curves = frame.number, read_curves(self.recording, frame, self.of_yarns)
        made = zip(self._cloth(frame), self.cloth.at(frame.t), strict=True)
        return [self._curves[1], *(mesh for mesh, one in made if one.yarns is None), *self._bodies(frame)]

    def _plain(self, frame: Frame) -> list[Mesh]:
        """Return all meshes of a frame, rotated to z up, without curves."""
        return [*self._cloth(frame), *self._bodies(frame)]

    def _fitted(self, frame: Frame) -> list[Mesh]:
        """Return the meshes to which the camera is fitted."""
        return self._cloth(frame) if self.view.close else self._plain(frame)

    def _cloth(self, frame: Frame) -> list[Mesh]:
        pieces = self.pieces(frame.t)
        check_size(self.recording, pieces, frame)
        pieces = pieces if self.dyed is None else self.dyed.dress(pieces, frame.t)
        painted = None if self.pressure is None else paint_pressure(self.pressure(frame.x), self.most)
        parts = [slice(piece.start, piece.stop) for piece in pieces]
        meshes = [
            _cloth_mesh(piece, frame.x[part], None if painted is None else painted[part])
            for piece, part in zip(pieces, parts, strict=True)
        ]
        return [replace(mesh, vertices=z_up(mesh.vertices), material=self.fabrics.get(piece.name, ""))
                for mesh, piece in zip(meshes, pieces, strict=True)]  # fmt: skip

    def _bodies(self, frame: Frame) -> list[Mesh]:
        points = body_vertices(self.recording, self.bodies, frame.t)
        if self.bodies is None or not len(points):
            return []
        skin = np.array([name.split("/")[0] in self.persons for name in self.bodies.frames])[self.bodies.frame]
        skin &= isinstance(self.renderer, Progressive)
        colours = np.where(skin[:, None], parse_hex(SKIN_COLOUR), parse_hex(BODY))
        return [Mesh(z_up(points), self.bodies.faces, colours, two_sided=False, material=SKIN if skin.any() else "")]

    def _ground(self, meshes: list[Mesh]) -> float | str:
        """Return the height of the scene's floor [m], else of the lowest point in any frame."""
        if self.bodies is not None and self.bodies.floor is not None:
            return self.bodies.floor
        heights = np.concatenate([np.zeros(0), *(mesh.vertices[:, 2] for mesh in meshes)])
        heights = heights[np.isfinite(heights)]
        return float(heights.min()) if len(heights) else "none"


def name_materials(scene: Mapping[str, Any]) -> tuple[dict[str, str], set[str]]:
    """Return the preset of each object's fabric in a recorded scene, by the object's name, and the bodies with skin."""
    fabrics = {str(one.get("name")): dict(one.get("model") or {}).get("fabric") for one in scene.get("objects") or ()}
    shapes = {str(one.get("name")): dict(one.get("collider") or {}) for one in scene.get("bodies") or ()}
    persons = {name for name, shape in shapes.items()
               if shape.get("plugin") in ("skeleton", "skin") or shape.get("shape") in ("person", "leg")}  # fmt: skip
    return {name: fabric for name, fabric in fabrics.items() if isinstance(fabric, str)}, persons


def check_sides(size: tuple[int, int] | None) -> None:
    """Raise BadInput for a picture's width or height outside the limits of a scene; None is fitted."""
    if size is not None and not all(16 <= side <= 8192 for side in size):
        raise BadInput("no such size", field="--size", value=size, limit="16 to 8192 pixels a side")


def check_colour(colour: str) -> None:
    """Raise BadInput for an unknown Colour."""
    if colour not in get_args(Colour):
        limit = ", ".join(get_args(Colour))
        raise BadInput("cloth cannot be painted by that", field="--colour", value=colour, limit=limit)


def export_picture(
    source: Recording | Path | str,
    path: Path,
    frame: int | None = None,
    size: tuple[int, int] | None = None,
    colour: Colour = "auto",
    changes: Changes | None = None,
    rendering: Rendering = PLAIN_RENDERING,
    progress: Progress | None = None,
) -> Path:
    """Draw one frame (default: the last) as PNG, of moving cloth or of dye alone, by the scene and the arguments that
    are not None. Raises BadInput for a missing frame, and for a picture that cannot be drawn or written.
    """
    check_target(path, ".png")
    check_sides(size)
    with opened(source) as recording:
        if recording.dyed_alone:
            with dyed_pictures(recording, changes) as pictures:
                return write_png(path, pictures.draw(find_amounts(recording, frame)))
        shown = read_frame(recording, frame)
        painter = Painter(recording, [shown], size, {}, colour, changes, rendering)
        return write_png(path, painter.draw(shown, progress=progress))


def draw_frames(
    recording: Recording, paint: Callable[..., Painter], numbers: list[int], progress: Progress | None = None,
    shutter: float = 0.0,
) -> Iterator[Picture]:  # fmt: skip
    """Draw chosen frames, in order, by a Painter of the recording whose camera is fitted to all, each as a shutter sees
    it that is open for so long [s]; a repeated number repeats its picture. Raises BadInput.
    """
    looks = {numbers[round(k * (len(numbers) - 1) / (LOOKS - 1))] for k in range(LOOKS)}
    shown = [frame for frame in recording.frames() if frame.number in looks]
    times = Counter(numbers)
    number = len(times) * (MOMENTS if shutter else 1)
    painter = paint(shown, options={"samples": 4}, number=number)

    def draw(frame: Frame) -> Picture:
        return painter.blur(frame, shutter) if shutter else painter.draw(frame)

    drawn = ((draw(frame), times.pop(frame.number)) for frame in recording.frames() if frame.number in times)
    yield from following((picture for picture, often in drawn for _ in range(often)), len(numbers), progress)


def draw_turn(
    paint: Callable[..., Painter], frame: Frame, numbers: list[int], progress: Progress | None = None
) -> Iterator[Picture]:
    """Draw a frame by a Painter of its recording from all sides, in a turn of as many pictures as there are numbers.
    Raises BadInput.
    """
    number = len(numbers)
    painter = paint([frame], options={"samples": 4}, number=number)
    painter.stand_back(frame)
    return (painter.draw(frame, 2.0 * np.pi * k / number) for k in following(range(number), number, progress))


def require_drawable(number: float) -> None:
    """Raise BadInput for more pictures than an animation may have: a falsified time gives any number of them."""
    if not number <= MOST_PICTURES:
        raise BadInput("too many pictures for an animation", value=f"{number:,.0f}", limit=f"{MOST_PICTURES:,}",
                       remedy="give a part of the recording: --start, --end")  # fmt: skip


def choose_frames(recording: Recording, fps: float, start: float | None, end: float | None) -> list[int]:
    """Return the numbers of the frames nearest to k / fps seconds from `start` to `end` [s].

    A picture lasts 1 / fps seconds whatever the recording's rate, so that time is real.
    Raises BadInput if there is nothing to show.
    """
    frames = {time / 1e9: number for time, (number, _) in recording.marks().items()}
    times = np.array(sorted(frames))
    if not len(times):
        raise BadInput("the recording holds no frames", str(recording.path))
    first = times[0] if start is None else max(start, times[0])
    last = times[-1] if end is None else min(end, times[-1])
    limit = f"{times[0]:g} to {times[-1]:g} s"
    frame = times[-1] - times[-2] if len(times) > 1 else 0.0  # a duration may end within a frame
    for name, asked in (("--start", start), ("--end", end)):
        if asked is not None and not times[0] - 1e-6 <= asked <= times[-1] + frame + 1e-6:
            problem = "nothing to show there: the recording has no such time"
            raise BadInput(problem, str(recording.path), field=name, value=asked, limit=limit)
    if not first <= last:
        raise BadInput("nothing to show between start and end", str(recording.path), value=(start, end), limit=limit)
    require_drawable((last - first) * fps)
    due = first + np.arange(math.floor((last - first) * fps + 1e-6) + 1) / fps
    nearest = np.clip(np.searchsorted(times, due), 1, max(len(times) - 1, 1))
    nearest -= due - times[nearest - 1] < times[np.minimum(nearest, len(times) - 1)] - due
    return [frames[times[i]] for i in np.minimum(nearest, len(times) - 1)]


def _cloth_mesh(piece: ShownPiece, x: Float, colours: Float | None = None) -> Mesh:
    """Return the mesh of a piece at x (n, 3), in its own paint or colours (n, 3); of a net thin tubes along springs."""
    if not len(piece.faces):
        vertices, faces, owner = tubes(x, piece.edges)
        each = np.repeat(paint_piece(piece, x), 2 * SIDES, axis=0) if colours is None else colours[owner]
        return Mesh(vertices, faces, each, two_sided=False)
    painted = paint_piece(piece, x) if colours is None and piece.image is None else colours
    if (laid := piece.laid_out) is None:
        return Mesh(x, piece.faces, painted)
    # The renderer shares the normals of vertices at one position.
    colours = None if painted is None else painted[laid.vertex]
    return Mesh(x[laid.vertex], laid.faces, colours, laid.in_image, piece.image)


def require_pressure(recording: Recording) -> Pressures:
    """Return a function for the pressure of a recording's knit. Raises BadInput for a recording without a knit."""
    pressure = read_pressure(recording)
    if pressure is None:
        problem, remedy = "the recording has no knit, which alone has a pressure", "leave --colour out"
        raise BadInput(problem, str(recording.path), field="--colour", value="pressure", remedy=remedy)
    return pressure
