"""Conversion of bus messages to rerun, for live runs, replays and recordings."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from nuno.bus.encodings import BadMessage, decode_arrays, decode_picture, decode_points
from nuno.collision.messages import decode_geometry, decode_poses
from nuno.dye.painter import DyePainter
from nuno.exports.cloth import coloured, cut_pieces
from nuno.formatting import duration
from nuno.simulation.yarns import SPAN
from nuno.viewer import layout
from nuno.viewer.cloth import BodiesView, Cloth, ReadImage, read_image
from nuno.viewer.dyed import DyedCloth
from nuno.viewer.layout import BACKGROUND
from nuno_schemas.colour import colours, to_srgb
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float
from nuno_schemas.messages import (
    BODIES,
    CLOTH,
    CONCENTRATION,
    CONTACT,
    DYE_STATUS,
    EVENT,
    FABRIC,
    GEOMETRY,
    PENETRATION,
    PICTURE,
    REPORT,
    STATE,
    STATUS,
    Contact,
    Event,
    Penetration,
    Status,
)
from nuno_schemas.pictures import Picture
from nuno_schemas.scene import View

# Explanations for the user: a page, and the colour scale of tension.

WIDTH, HEIGHT = 1200, 110
"""Size of the colour scale's picture [pixels]."""
SIDE, TOP, BOTTOM = 90, 12, 56
"""Margin of the bar on both sides, its first row, and the row below it [pixels]."""
FONT, INK = 30, (40, 44, 52)


def about(scene: str, vertices: int, faces: int, speed: float | None = None) -> str:
    """Return an explanation of the picture, as Markdown; `speed` is that of the dye, if any."""
    dyed = f"\n**Dye**: a second here is {duration(speed)} of dyeing.\n" if speed is not None else ""
    return f"""# {scene}
{vertices:,} vertices, {faces:,} triangles.

**Colour**: cloth has its texture, its colour, or one by its place in the scene. Links of nets, and all cloth of a scene
with `view: {{colour: stretch}}`, show the stretch of the most stretched thread, on a logarithmic scale:

| colour | stretch |
| --- | --- |
| violet | 0.1 % and less |
| blue | 1 % |
| green | 10 % |
| yellow | 100 % and more |
| grey | not a number |

Nets of yarns show the yarn that each link is of, or its tension, where the scene's view has `links: yarn` or
`links: tension`.
{dyed}"""


def about_tension(most: list[float]) -> str:
    """Return an explanation of tension's colours, as Markdown; `most` is the largest tension [N] of each net."""
    if not most:
        return ""
    return f"""
**Links of yarns**: their tension along the yarn, by the scale below the scene. Its end, {most[0]:.3g} N, is that of the
stiffest link as long again as at rest.
"""


def tension_legend(most: float) -> NDArray[np.uint8]:
    """Return the picture (HEIGHT, WIDTH, 3) sRGB of a logarithmic bar from the largest tension `most` [N] down to
    `most` / SPAN, with a label at each decade.
    """
    from PIL import Image, ImageDraw, ImageFont

    picture = np.empty((HEIGHT, WIDTH, 3), np.uint8)
    picture[:] = BACKGROUND
    bar = colours(np.linspace(0.0, 1.0, WIDTH - 2 * SIDE), 0.0, 1.0)
    picture[TOP:BOTTOM, SIDE:-SIDE] = np.round(255.0 * to_srgb(bar))
    image = Image.fromarray(picture)
    draw, font = ImageDraw.Draw(image), ImageFont.load_default(FONT)
    unit, name = (1.0, "N") if most >= 1.0 else (1e-3, "mN")
    for share, tension in ticks(most):
        x = SIDE + round(share * (WIDTH - 2 * SIDE - 1))
        draw.line((x, BOTTOM, x, BOTTOM + 10), INK, 3)
        draw.text((x, BOTTOM + 14), f"{tension / unit:.3g} {name}", INK, font, anchor="mt")
    return np.asarray(image)


def ticks(most: float) -> list[tuple[float, float]]:
    """Return (share of the bar's length, tension [N]) of each decade below the largest tension, ascending."""
    count = round(math.log10(SPAN))
    return [(i / count, most * SPAN ** (i / count - 1.0)) for i in range(count + 1)]


# Crossings of cloth with cloth in rerun, and the least distance.

PASSES = [214, 39, 40]
"""Red, a colour of no fabric."""
POINT = 5.0
"""Radius of a point on the screen, at any distance."""


class CrossingsView:
    """Logs red points where edges of cloth pass through triangles, with one label per pair of objects, and the least
    distance of cloth from cloth as a curve, with a gap while it is more than the thickness.
    """

    def __init__(self, recording: Any) -> None:
        self.recording = recording
        self._shown: set[str] = set()
        recording.log("/plots/distance", layout.names(["least distance"]), static=True, strict=True)

    def log(self, report: Penetration) -> None:
        """Log the report of the present frame."""
        distance = math.nan if report.distance is None else 1000.0 * report.distance
        self.recording.log("/plots/distance", rr.Scalars(distance), strict=True)
        crossings: dict[str, list[tuple[float, float, float]]] = {}
        labels: dict[str, str] = {}
        for place, pair in zip(report.places, report.objects, strict=True):
            one, other = sorted(pair)
            path = layout.entity("world", "crossings", one, other)
            crossings.setdefault(path, []).append(place)
            labels[path] = f"{one} passes through {'itself' if one == other else other}"
        for path in self._shown - crossings.keys():
            self.recording.log(path, rr.Clear(recursive=False), strict=True)
        for path, places in crossings.items():
            points = rr.Points3D(
                places, radii=rr.Radius.ui_points(POINT), colors=[PASSES], labels=[labels[path]], show_labels=True
            )
            self.recording.log(path, points, strict=True)
        self._shown = set(crossings)


BATCH = 32
"""Number of poses that are written to a file together."""


class Bridge:
    """Logs a run's messages to a rerun recording stream, in the order of `feed`.

    recording  a `rerun.RecordingStream`
    view       the scene's view; the eye is fitted to the first frame by it
    live       the viewer follows the newest frame instead of playing from the start
    images     reads a texture by its path; returns None if it cannot
    painter    draws the scene's dyed cloth; None for a scene without dye
    colour     how all cloth is painted, cloth or stretch; auto: as the view says

    Poses are logged in batches: `flush` logs the last ones. `feed` raises BadMessage for a
    payload that does not match its topic, and leaves the view unchanged.
    """

    def __init__(
        self,
        recording: Any,
        view: View | None = None,
        live: bool = False,
        images: ReadImage = read_image,
        painter: DyePainter | None = None,
        colour: str = "auto",
    ) -> None:
        self.colour = colour
        self.recording, self.view, self.live, self.images = recording, view or View(), live, images
        self.play: layout.Play = "following" if live else "playing"
        self.frames = 0
        self._cloths: list[Cloth] = []
        self._fabrics: dict[str, int] = {}
        self._vertices = -1
        self._pinned = np.zeros(0, bool)
        self._bodies: BodiesView | None = None
        self._crossings: CrossingsView | None = None
        self._speed = painter.speed if painter is not None else None
        self._dyed_object = painter.object if painter is not None else None
        self._dyed: DyedCloth | None = None
        if painter is not None:
            wear = self._wear if painter.object is not None else None
            self._dyed = DyedCloth(recording, painter, live, wear, self._arrange)
        self._energy: list[str] = []
        self._latest = (0, 0.0)
        self._eye: layout.Eye | None = None
        self._felt = False
        """Whether contact forces on bodies are shown."""
        self._first: Float | None = None
        """Positions of the cloth's first frame, until the bodies have poses, too."""
        self._pictured = False
        self._handlers: dict[str, Callable[[bytes], None]] = {
            FABRIC.name: self._fabric,
            STATE.name: self._state,
            STATUS.name: self._status,
            GEOMETRY.name: self._geometry,
            BODIES.name: self._poses,
            PENETRATION.name: self._penetration,
            CONTACT.name: self._contact,
            PICTURE.name: self._picture,
            EVENT.name: self._event,
            REPORT.name: self._report,
        }
        if self._dyed is not None:
            self._handlers |= {
                CLOTH.name: self._dyed.take_cloth,
                CONCENTRATION.name: self._amounts,
                DYE_STATUS.name: self._dyed.take_status,
            }
        # Wall-clock timelines would make two conversions of one recording differ.
        recording.set_log_time_enabled(False)
        recording.set_log_tick_enabled(False)
        self._log("/world", rr.ViewCoordinates.RIGHT_HAND_Y_UP, static=True)

    def feed(self, topic: str, frame: int, t: float, payload: bytes) -> None:
        """Log one message, unless its topic is not shown. A message outside any frame
        (frame < 0) is logged at the latest time.
        """
        kind = EVENT.name if topic.startswith(EVENT.name + "/") else topic
        handler = self._handlers.get(kind)
        if handler is None:
            return
        if not (math.isfinite(t) and abs(t) < 2**33 and frame < 2**62):
            raise BadMessage(f"frame {frame} at {t} s")
        if frame >= 0:
            self._latest = (frame, t)
        if self._dyed is not None:
            self._dyed.set_time(*self._latest)
        else:
            layout.set_time(self.recording, *self._latest)
        try:
            handler(payload)
        except (LookupError, TypeError, AttributeError, ArithmeticError, ValueError, RecursionError, BadInput) as error:
            raise BadMessage(f"{topic}: {error}") from None

    def flush(self) -> None:
        """Log the last batch of poses, and the last picture; call it at the end."""
        if self._bodies is not None:
            self._bodies.flush()
        if self._dyed is not None:
            self._dyed.flush()

    def loop(self) -> None:
        """Have the viewer play all frames again and again."""
        self.play = "looping"
        self._arrange()
        if self._dyed is not None and self._dyed.names:
            self._dyed.arrange_window(self.play)

    def _log(self, path: str, *what: Any, static: bool = False) -> None:
        self.recording.log(path, *what, static=static, strict=True)

    def _fabric(self, payload: bytes) -> None:
        arrays, text = decode_arrays(payload)
        pieces, number = cut_pieces(arrays, text, self.view.colour == "stretch"), int(text["vertices"])
        self._vertices = number
        self._pinned = arrays["pinned"].astype(bool)
        for cloth in self._cloths:
            cloth.clear()
        self._cloths = []
        # Static data hide all later data of their entity: changed cloth has an entity of its own.
        version = self._fabrics.setdefault(hashlib.blake2b(payload).hexdigest(), len(self._fabrics))
        for piece in pieces:
            path = layout.entity("world", "cloth", piece.name, *([str(version)] if version else []))
            dyed, links = piece.name == self._dyed_object and self.colour != "stretch", self.view.links
            if self.colour != "auto":
                piece, links = coloured(piece, self.colour), "yarn"
            cloth = Cloth(self.recording, path, piece, self.images, dyed, links)
            self._cloths.append(cloth)
            if cloth.untextured:
                text_of = f"the texture of {piece.name} cannot be read: {piece.texture}"
                self._log("/log", rr.TextLog(text_of, level="WARN"))
        if self._dyed is not None and self._dyed.shown is not None:
            self._wear(self._dyed.shown)
        tensions = [cloth.tensions.most for cloth in self._cloths if cloth.tensions]
        if tensions:
            self._log(layout.LEGEND, rr.Image(tension_legend(tensions[0])), static=True)
        self._log(
            "/about",
            rr.TextDocument(
                about(str(text.get("scene", "")), number, len(arrays["faces"]), self._speed) + about_tension(tensions),
                media_type="text/markdown",
            ),
            static=True,
        )

    def _state(self, payload: bytes) -> None:
        positions = decode_points(payload)
        if len(positions) != self._vertices:
            raise BadMessage(f"{len(positions)} points for a fabric of {self._vertices} vertices")
        if self._eye is None:
            self._aim(positions)
            self._first = positions
        for cloth in self._cloths:
            cloth.log(positions)
        self.frames += 1

    def _aim(self, positions: Float) -> None:
        """Arrange the window around the first frame."""
        bodies = np.zeros((0, 3)) if self._bodies is None else self._bodies.points()
        self._eye = layout.fit_eye(layout.stage(positions, self._pinned, bodies), self.view)
        self._arrange()

    def _arrange(self) -> None:
        if self._eye is not None:
            dyes = self._dyed.names if self._dyed is not None else []
            legend = any(cloth.tensions for cloth in self._cloths)
            bodies, meets = self._bodies is not None, self._crossings is not None
            ground = self._bodies is not None and self._bodies.ground
            shown = self._pictured, legend, meets, ground, self._felt
            blueprint = layout.arrange(self._eye, bodies, self.play, dyes, *shown)
            self.recording.send_blueprint(blueprint, make_active=True, make_default=True)

    def _status(self, payload: bytes) -> None:
        status = Status.model_validate_json(payload)
        energy = list(status.energy)
        if energy != self._energy:
            self._energy = energy
            self._log("/plots/energy", layout.names([*energy, "total"]), static=True)
            self._log("/plots/stretch", layout.names(["largest stretch"]), static=True)
            self._log("/plots/time", layout.names(["computing the frame"]), static=True)
        values = [layout.number(value) for value in status.energy.values()]
        self._log("/plots/energy", rr.Scalars([*values, sum(values)]))
        self._log("/plots/stretch", rr.Scalars(100.0 * layout.number(status.stretch)))
        self._log("/plots/time", rr.Scalars(1000.0 * status.step_seconds))
        if status.message:
            self._log("/log", rr.TextLog(status.message, level="INFO" if status.state == "running" else "WARN"))

    def _geometry(self, payload: bytes) -> None:
        self.flush()
        self._bodies = BodiesView(self.recording, decode_geometry(payload), 1 if self.live else BATCH)
        self._log("/plots/penetration", layout.names(["deepest", "mean of those inside"]), static=True)
        self._arrange()

    def _poses(self, payload: bytes) -> None:
        poses = decode_poses(payload)
        if self._bodies is None:
            raise BadMessage("poses of bodies that are not known yet")
        self._bodies.move(self._latest[0], poses)
        if self._first is not None:  # bodies come after the cloth's first frame, and must be in view
            first, self._first = self._first, None
            self._aim(first)

    def _penetration(self, payload: bytes) -> None:
        report = Penetration.model_validate_json(payload)
        self._log("/plots/penetration", rr.Scalars([1000.0 * report.depth, 1000.0 * report.mean]))
        if report.crossings is not None:
            if self._crossings is None:
                self._crossings = CrossingsView(self.recording)
                self._arrange()
            self._crossings.log(report)

    def _contact(self, payload: bytes) -> None:
        felt = Contact.model_validate_json(payload).bodies
        if not self._felt:
            self._felt = True
            self._log("/plots/contact", layout.names([one.body for one in felt]), static=True)
            self._arrange()
        self._log("/plots/contact", rr.Scalars([math.hypot(*one.force) for one in felt]))

    def _amounts(self, payload: bytes) -> None:
        assert self._dyed is not None
        self._dyed.take_amounts(*self._latest, payload)
        self.frames += self._dyed_object is None

    def _wear(self, picture: Picture) -> None:
        """Give the dyed object its texture."""
        for cloth in self._cloths:
            if cloth.dyed:
                cloth.log_texture(picture)

    def _picture(self, payload: bytes) -> None:
        self._log(layout.YARNS, rr.EncodedImage(contents=decode_picture(payload), media_type="image/png"))
        if not self._pictured:
            self._pictured = True
            self._arrange()

    def _event(self, payload: bytes) -> None:
        event = Event.model_validate_json(payload)
        if self._dyed is not None:
            # A paused run sends no more frames: the waiting one is the present one.
            self._dyed.flush()
        level = {"error": "ERROR", "warning": "WARN"}.get(event.kind, "INFO")
        self._log("/log", rr.TextLog(f"{event.service}: {event.message}", level=level))

    def _report(self, payload: bytes) -> None:
        text = json.dumps(json.loads(payload), indent=2)
        self._log("/report", rr.TextDocument(f"```json\n{text}\n```", media_type="text/markdown"), static=True)
