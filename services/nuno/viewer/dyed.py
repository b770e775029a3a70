"""A dyed cloth in rerun: its picture, and the curves of its amounts."""

from __future__ import annotations

import io
import math
import time
from collections.abc import Callable, Mapping

import numpy as np
import rerun as rr

from nuno.bus.encodings import decode_arrays
from nuno.dye.painter import DyePainter
from nuno.scene.scene_file import Loaded
from nuno.viewer import layout
from nuno.viewer.fields import round_up
from nuno_schemas.fabric import Float
from nuno_schemas.messages import DyeStatus
from nuno_schemas.pictures import Picture

MOST_PIXELS = 2**21
"""Most pixels of a picture in the viewer; the scale is reduced accordingly."""
TEXTURE_PIXELS, TEXTURES = 2**18, 100
"""Most pixels of an object's texture, which rerun does not accept as JPEG; and the most textures of a scene, unless
it gives their interval."""
LIVE_SECONDS = 0.1
"""Least time between two pictures of a live view [s]: drawing must not fall behind a fast run."""
QUALITY = 92
"""Quality of JPEG. Pictures of yarns have detail everywhere: PNG takes four times as much space."""
AMOUNTS, WIDTHS = ("supplied", "total", "mobile", "fixed"), (5.0, 2.0, 2.0, 2.0)
"""Curves of each dye. Supplied is the widest, and first: total lies on it."""
TIME = "computing the frame"
REACHED = 0.01
"""A dye has reached a cell that holds at least this share of what a cell can."""


class DyedCloth:
    """Logs pictures of dyed cloth, without repetitions, and curves of its amounts.

    entities  where they are
    painter   draws the pictures; `every` of its scene's picture [s] is the time between two pictures
    live      pictures may be skipped; `flush` shows the last of them
    wear      logs a picture as the texture of the dyed object in the 3-D scene; None for dye alone, which has only
              the picture
    arrange   rearranges the window of the 3-D scene
    """

    def __init__(
        self,
        entities: layout.Entities,
        painter: DyePainter,
        live: bool,
        wear: Callable[[Picture], None] | None,
        arrange: Callable[[], None],
    ) -> None:
        self.entities, self.recording, self.painter, self.live = entities, entities.recording, painter, live
        self.every = painter.look.every or (0.0 if wear is None else painter.duration / TEXTURES)
        self.names: list[str] = []
        self.shown: Picture | None = None
        self._wear, self._arrange = wear, arrange
        self._waiting: tuple[int, float, bytes] | None = None
        self._fronts: Callable[[bytes], Mapping[str, float]] | None = None
        """Returns the radius that each dye has reached [mm], of flat cloth once it is known."""
        self._drawn = -math.inf
        """Wall time of drawing the last picture [s]."""
        self._last = -math.inf
        """Scene time of the last picture [s]."""

    def set_time(self, frame: int, t: float) -> None:
        """Set the time of the following log calls: a frame at t [s] of the scene."""
        if self._wear is not None:
            layout.set_time(self.recording, frame, t)
            return
        self.recording.reset_time()  # removes other timelines of this thread
        self.recording.set_time("frame", sequence=frame)
        self.recording.set_time(layout.DYE_TIMELINE, duration=t * self.painter.speed)

    def take_cloth(self, payload: bytes) -> None:
        """Set the cloth. Raises BadMessage, and BadInput for a cloth that cannot be drawn."""
        self.painter.take_cloth(payload)
        self.shown = None
        if self._wear is None:
            arrays, text = decode_arrays(payload)
            names, full = list(text["dyes"]), float(text["v_max"])
            self.entities.name_curves("front", names)
            self._fronts = lambda amounts: dict(
                zip(names, 1e3 * front_radii(amounts, full, self.painter.size), strict=True)
            )
            self.entities.show_page("about", about(str(text.get("scene", "")), self.painter, arrays["fibre"].shape))
            self._log_scale()

    def take_amounts(self, frame: int, t: float, payload: bytes) -> None:
        """Show a frame, now or later. Raises BadMessage."""
        if self._fronts is not None:
            self.entities.log_values("front", self._fronts(payload))
        early = t < self._last + self.every * (1.0 - 1e-9)
        if early or (self.live and time.monotonic() < self._drawn + LIVE_SECONDS):
            self._waiting = frame, t, payload
            return
        self._draw(frame, t, payload)

    def flush(self) -> None:
        """Show the waiting frame, if any."""
        if self._waiting is not None:
            self._draw(*self._waiting)

    def take_status(self, payload: bytes) -> None:
        """Log the amounts of a frame."""
        status = DyeStatus.model_validate_json(payload)
        if list(status.mobile) != self.names:
            self.names = list(status.mobile)
            for name in self.names:
                self.entities.name_curves(f"dye/{name}", AMOUNTS, WIDTHS)
            self.arrange_window("following" if self.live else "playing")
        for name in self.names:
            mobile, fixed = (layout.number(amount.get(name)) for amount in (status.mobile, status.fixed))
            values = (layout.number(status.supplied.get(name)), mobile + fixed, mobile, fixed)
            self.entities.log_values(f"dye/{name}", dict(zip(AMOUNTS, values, strict=True)))
        if self._wear is None:
            self.entities.log_values("time", {TIME: 1000.0 * status.step_seconds})
        self.entities.tell_message(status)

    def arrange_window(self, play: layout.Play) -> None:
        """Arrange the window once the dyes are known."""
        if self._wear is not None:
            self._arrange()
            return
        self.entities.name_curves("time", [TIME])
        if self.entities.run:  # compared runs have one blueprint in common
            return
        blueprint = layout.arrange_dyed(self.names, self.painter.shape, self.duration, play)
        self.recording.send_blueprint(blueprint, make_active=True, make_default=True)

    @property
    def duration(self) -> float:
        """Time of the whole dyeing [s]."""
        return self.painter.duration * self.painter.speed

    def _log_scale(self) -> None:
        """Log a bar of about a fifth of the picture's width, of a round length."""
        height, width = self.painter.shape
        length = round_up(0.1 * width * self.painter.pixel)
        x, y = 0.04 * width, 0.95 * height
        bar = [[x, y], [x + length / self.painter.pixel, y]]
        strips = rr.LineStrips2D(
            [bar, bar], colors=[[255, 255, 255], [30, 30, 30]], radii=[-4.0, -1.5], draw_order=10.0
        )
        self.entities.log(f"{self._picture}/scale", strips, static=True)
        end = rr.Points2D(
            [bar[1]],
            radii=0.0,
            colors=[[255, 255, 255]],
            labels=[f"{1e3 * length:.4g} mm"],
            show_labels=True,
            draw_order=11.0,
        )
        self.entities.log(f"{self._picture}/scale/length", end, static=True)

    @property
    def _picture(self) -> str:
        return self.entities.page(layout.PICTURE)

    def _draw(self, frame: int, t: float, payload: bytes) -> None:
        self._waiting = None
        picture = self.painter.draw(payload)
        self._drawn, self._last = time.monotonic(), t
        if self.shown is not None and np.array_equal(picture, self.shown):
            return
        self.set_time(frame, t)
        if self._wear is not None:
            self._wear(picture)
        else:
            self.entities.log(self._picture, rr.EncodedImage(contents=_jpeg(picture), media_type="image/jpeg"))
        self.shown = picture


def front_radii(payload: bytes, full: float, size: float) -> Float:
    """Return for each dye of a frame's message the radius (dyes,) [m] of a disc as large as the cells that it has
    reached, in cloth with cells of `size` [m] that can hold `full`: of one drop, how far its front is from its middle.
    """
    arrays, _ = decode_arrays(payload)
    reached = ((arrays["phi"] + arrays["fixed"]).max(axis=1) >= REACHED * full).sum(axis=(1, 2))
    return np.asarray(size * np.sqrt(reached / np.pi))


def viewer_painter(loaded: Loaded) -> DyePainter:
    """Return the painter of a scene's dye for the viewer. Raises BadInput for a scene without dye."""
    dressed = loaded.scene.dye is not None and loaded.scene.dye.object is not None
    return DyePainter(loaded, most=TEXTURE_PIXELS if dressed else MOST_PIXELS)


def about(scene: str, painter: DyePainter, shape: tuple[int, ...]) -> str:
    """Return an explanation of the picture for the user, as Markdown."""
    _, ny, nx = shape
    content = {
        "all": "all dye, mobile and fixed",
        "fixed": "the dye that fibre has fixed, and no other",
        "mobile": "the dye that is mobile, and not what fibre has fixed",
    }[painter.look.view]
    return f"""# {scene}
{nx} x {ny} cells of {1e3 * painter.size:.3g} mm in two layers; a pixel is {1e6 * painter.pixel:.3g} um wide.

**Picture**: {content}.

**Curves**: amounts in full cells. Mobile and fixed are what the cloth holds, total is both, and
supplied is what it was given so far: total and supplied lie on each other.
"""


def _jpeg(picture: Picture) -> bytes:
    from PIL import Image

    stream = io.BytesIO()
    Image.fromarray(picture).save(stream, "JPEG", quality=QUALITY, subsampling=0)
    return stream.getvalue()
