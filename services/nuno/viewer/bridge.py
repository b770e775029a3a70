"""Conversion of bus messages to rerun, for live runs, replays and recordings."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import rerun as rr

from nuno.bus.encodings import BadMessage, decode_arrays, decode_picture, decode_points
from nuno.collision.crossings import Mesh, mesh_of, near_pairs
from nuno.collision.distance import vertex_distances
from nuno.collision.messages import decode_geometry, decode_poses
from nuno.dye.painter import DyePainter
from nuno.exports.cloth import cut_pieces, read_indices
from nuno.formatting import duration
from nuno.report.run_report import recorded_lines
from nuno.viewer import layout
from nuno.viewer.cloth import BodiesView, Cloth, ReadImage, fields_of, read_image
from nuno.viewer.dyed import DyedCloth
from nuno.viewer.fields import QUANTITIES, Scale
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
    TOUCHES,
    Contact,
    Event,
    Penetration,
    Status,
)
from nuno_schemas.pictures import Picture
from nuno_schemas.scene import View

# Explanation for the user.


def about(scene: str, vertices: int, faces: int, speed: float | None = None) -> str:
    """Return an explanation of the picture, as Markdown; `speed` is that of the dye, if any."""
    dyed = f"\n**Dye**: a second here is {duration(speed)} of dyeing.\n" if speed is not None else ""
    return f"""# {scene}
{vertices:,} vertices, {faces:,} triangles.

**Tabs of the scene**: *Cloth* shows textures and colours, of nets the kinds of yarn; the others colour cloth by a
value, on the linear scale below. Its end grows with the values of the run, but for the largest hundredth of each frame,
which have the colour of the end. Grey is not a number.

**Hidden at first** (the panel on the left shows them): points of contact with bodies and their forces, and pins.
{dyed}"""


# Crossings of cloth with cloth in rerun, and the least distance.

PASSES = [214, 39, 40]
"""Red, a colour of no fabric."""
POINT = 5.0
"""Radius of a point on the screen, at any distance."""
PIN, TOUCH = [192, 57, 43], [39, 110, 160]
ARROW = 0.2
"""Length of the longest arrow of a contact force [m]."""


class CrossingsView:
    """Logs red points where edges of cloth pass through triangles, with one label per pair of objects, and the least
    distance of cloth from cloth as a curve, with a gap while it is more than the thickness.
    """

    def __init__(self, entities: layout.Entities) -> None:
        self.entities = entities
        self._shown: set[str] = set()
        entities.name_curves("distance", ["least distance", "thickness"])

    def log(self, report: Penetration) -> None:
        """Log the report of the present frame."""
        values = {"least distance": math.nan if report.distance is None else 1000.0 * report.distance}
        if report.thickness:
            values["thickness"] = 1000.0 * report.thickness
        self.entities.log_values("distance", values)
        crossings: dict[str, list[tuple[float, float, float]]] = {}
        labels: dict[str, str] = {}
        for place, pair in zip(report.places, report.objects, strict=True):
            one, other = sorted(pair)
            path = self.entities.world("crossings", one, other)
            crossings.setdefault(path, []).append(place)
            labels[path] = f"{one} passes through {'itself' if one == other else other}"
        for path in self._shown - crossings.keys():
            self.entities.log(path, rr.Clear(recursive=False))
        for path, places in crossings.items():
            points = rr.Points3D(
                places, radii=rr.Radius.ui_points(POINT), colors=[PASSES], labels=[labels[path]], show_labels=True
            )
            self.entities.log(path, points)
        self._shown = set(crossings)


class TouchesView:
    """Logs the points at which cloth touches bodies, and the force on the body at each as an arrow."""

    def __init__(self, entities: layout.Entities) -> None:
        self.entities, self.path = entities, entities.world("contact")
        self._strongest = 0.0

    def log(self, places: Float, forces: Float) -> None:
        """Log touches at places (n, 3) [m] with forces (n, 3) [N]; the run's strongest so far is ARROW long."""
        self._strongest = max(self._strongest, float(np.linalg.norm(forces, axis=1).max(initial=0.0)))
        points = rr.Points3D(places, radii=rr.Radius.ui_points(0.5 * POINT), colors=[TOUCH])
        self.entities.log(f"{self.path}/points", points)
        arrows = rr.Arrows3D(origins=places, vectors=forces * (ARROW / (self._strongest or 1.0)), colors=[TOUCH])
        self.entities.log(f"{self.path}/forces", arrows)


BATCH = 32
"""Number of poses that are written to a file together."""


class Bridge:
    """Logs a run's messages to a rerun recording stream, in the order of `feed`.

    recording  a `rerun.RecordingStream`
    view       the scene's view; the eye is fitted to the first frame by it
    live       the viewer follows the newest frame instead of playing from the start
    images     reads a texture by its path; returns None if it cannot
    painter    draws the scene's dyed cloth; None for a scene without dye
    colour     what is seen first: cloth, or a field; auto: as the view says
    entities   those of a run that is compared with others, which leaves the blueprint to the comparison
    scales     colour scales of fields by name, which compared runs share

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
        entities: layout.Entities | None = None,
        scales: dict[str, Scale] | None = None,
    ) -> None:
        self.colour, self.entities = colour, entities or layout.Entities(recording)
        self.recording, self.view, self.live, self.images = recording, view or View(), live, images
        self.play: layout.Play = "following" if live else "playing"
        self.frames = 0
        self.scales = {name: Scale(quantity) for name, quantity in QUANTITIES.items()} if scales is None else scales
        self.window = layout.Window()
        self.cloths: list[Cloth] = []
        self.positions: Float | None = None
        """Those of the newest frame (n, 3) [m], with the number `_placed`."""
        self._placed = -1
        self.stage = np.zeros((0, 3))
        """Points (n, 3) [m] that should be in view."""
        self._fabrics: dict[str, int] = {}
        self._vertices = -1
        self._pinned = np.zeros(0, bool)
        self._bodies: BodiesView | None = None
        self._crossings: CrossingsView | None = None
        self._touches: TouchesView | None = None
        self._faces = np.zeros((0, 3), np.int32)
        self._mesh: Mesh | None = None
        """The cloth's triangles and edges, once a nearness is shown."""
        self._apart = False
        """Whether the nearness that is shown is none."""
        self._speed = painter.speed if painter is not None else None
        self._dyed_object = painter.object if painter is not None else None
        self.dyed: DyedCloth | None = None
        if painter is not None:
            wear = self._wear if painter.object is not None else None
            self.dyed = DyedCloth(self.entities, painter, live, wear, self._arrange)
        self._energy: list[str] = []
        self._counts: list[str] = []
        self._raised: float | None = None
        """Energy of gravity in the first frame [J]: it has no zero of its own."""
        self._latest = (0, 0.0)
        self._eye: layout.Eye | None = None
        self._first: Float | None = None
        """Positions of the cloth's first frame, until the bodies have poses, too."""
        self._handlers = self._by_topic()
        # Wall-clock timelines would make two conversions of one recording differ.
        recording.set_log_time_enabled(False)
        recording.set_log_tick_enabled(False)
        self.entities.log("/world", rr.ViewCoordinates.RIGHT_HAND_Y_UP, static=True)

    def _by_topic(self) -> dict[str, Callable[[bytes], None]]:
        """Return what handles the messages of each shown topic."""
        handlers: dict[str, Callable[[bytes], None]] = {
            FABRIC.name: self._fabric,
            STATE.name: self._state,
            STATUS.name: self._status,
            GEOMETRY.name: self._geometry,
            BODIES.name: self._poses,
            PENETRATION.name: self._penetration,
            CONTACT.name: self._contact,
            TOUCHES.name: self._touch,
            PICTURE.name: self._picture,
            EVENT.name: self._event,
            REPORT.name: self._report,
        }
        if self.dyed is not None:
            handlers |= {
                CLOTH.name: self.dyed.take_cloth,
                CONCENTRATION.name: self._amounts,
                DYE_STATUS.name: self.dyed.take_status,
            }
        return handlers

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
        if self.dyed is not None:
            self.dyed.set_time(*self._latest)
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
        if self.dyed is not None:
            self.dyed.flush()

    def loop(self) -> None:
        """Have the viewer play all frames again and again."""
        self.play = "looping"
        self._arrange()
        if self.dyed is not None and self.dyed.names:
            self.dyed.arrange_window(self.play)

    def offer(self, cloth: Cloth, field: str) -> None:
        """Let a field of this cloth be chosen in the viewer."""
        first = field not in self.window.fields
        path, visualizer = cloth.coloured_by(field)
        self.window.fields.setdefault(field, {})[path] = visualizer
        if first:
            self.entities.log(layout.legend(field), rr.Image(self.scales[field].legend()))

    def _fabric(self, payload: bytes) -> None:
        arrays, text = decode_arrays(payload)
        pieces, number = cut_pieces(arrays, text), int(text["vertices"])
        self._vertices = number
        self._pinned = arrays["pinned"].astype(bool)
        self._faces, self._mesh = arrays["faces"], None
        for cloth in self.cloths:
            cloth.clear()
        self.cloths = []
        # Static data hide all later data of their entity: changed cloth has an entity of its own.
        version = self._fabrics.setdefault(hashlib.blake2b(payload).hexdigest(), len(self._fabrics))
        for piece in pieces:
            path = self.entities.world("cloth", piece.name, *([str(version)] if version else []))
            cloth = Cloth(self.recording, path, piece, self.images, self.scales, piece.name == self._dyed_object)
            self.cloths.append(cloth)
            if cloth.untextured:
                text_of = f"the texture of {piece.name} cannot be read: {piece.texture}"
                self.entities.tell(text_of, "WARN")
            for name in fields_of(piece):
                self.offer(cloth, name)
        self.window.active = self._first_field()
        if self.dyed is not None and self.dyed.shown is not None:
            self._wear(self.dyed.shown)
        page = about(str(text.get("scene", "")), number, len(arrays["faces"]), self._speed)
        self.entities.show_page("about", page)
        self._arrange()

    def _first_field(self) -> str:
        """Return the field that is seen first, "" for the cloth's own look."""
        if self.colour != "auto":
            return self.colour
        if any(cloth.meshed for cloth in self.cloths):
            return "stretch" if self.view.colour == "stretch" else ""
        return self.view.links if self.view.links in self.window.fields else ""

    def _state(self, payload: bytes) -> None:
        positions = decode_points(payload)
        if len(positions) != self._vertices:
            raise BadMessage(f"{len(positions)} points for a fabric of {self._vertices} vertices")
        self.positions, self._placed = positions, self._latest[0]
        if self._eye is None:
            self._aim(positions)
            self._first = positions
        for cloth in self.cloths:
            cloth.log(positions)
        if self._pinned.any():
            pins = rr.Points3D(positions[self._pinned], radii=rr.Radius.ui_points(0.5 * POINT), colors=[PIN])
            self.entities.log(self.entities.world("pins"), pins)
        self.frames += 1

    def _aim(self, positions: Float) -> None:
        """Arrange the window around the first frame."""
        bodies = np.zeros((0, 3)) if self._bodies is None else self._bodies.points()
        self.stage = layout.stage(positions, self._pinned, bodies)
        self._eye = layout.fit_eye(self.stage, self.view)
        self._arrange()

    def _arrange(self) -> None:
        """Send the present blueprint; compared runs have one in common, which is sent at their end."""
        if self._eye is None or self.entities.run:
            return
        self.window.dyes = self.dyed.names if self.dyed is not None else []
        self.recording.send_blueprint(layout.arrange(self._eye, self.window, self.play), make_active=True,
                                      make_default=True)  # fmt: skip

    def _status(self, payload: bytes) -> None:
        status = Status.model_validate_json(payload)
        energy = list(status.energy)
        if energy != self._energy:
            self._energy = energy
            self.entities.name_curves("energy", [*energy, "total"])
            self.entities.name_curves("stretch", ["largest stretch"])
            self.entities.name_curves("time", ["computing the frame"])
        values = {name: layout.number(value) for name, value in status.energy.items()}
        if "gravitational" in values:
            if self._raised is None:
                self._raised = values["gravitational"]
            values["gravitational"] -= self._raised
        self.entities.log_values("energy", values | {"total": sum(values.values())})
        self.entities.log_values("stretch", {"largest stretch": 100.0 * layout.number(status.stretch)})
        self.entities.log_values("time", {"computing the frame": 1000.0 * status.step_seconds})
        if status.counts and list(status.counts) != self._counts:
            self._counts = list(status.counts)
            self.entities.name_curves("counts", self._counts)
            self.window.counted = True
            self._arrange()
        self.entities.log_values("counts", status.counts)
        self.entities.tell_message(status)

    def _geometry(self, payload: bytes) -> None:
        self.flush()
        self._bodies = BodiesView(self.entities, decode_geometry(payload), 1 if self.live else BATCH)
        self.entities.name_curves("penetration", ["deepest", "mean of those inside"])
        self.window.bodies, self.window.ground = True, self._bodies.ground
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
        depths = {"deepest": 1000.0 * report.depth, "mean of those inside": 1000.0 * report.mean}
        self.entities.log_values("penetration", depths)
        if report.crossings is not None:
            if self._crossings is None:
                self._crossings = CrossingsView(self.entities)
                self.window.meets = True
                self._arrange()
            self._crossings.log(report)
        if report.thickness is not None and self.positions is not None and report.frame == self._placed:
            self._show_nearness(self.positions, report.thickness, report.distance is None)

    def _show_nearness(self, x: Float, thickness: float, apart: bool) -> None:
        """Colour cloth by how much nearer it is to cloth than its thickness [m], which is nowhere if it is `apart`."""
        meshed = [cloth for cloth in self.cloths if cloth.meshed]
        if self._mesh is None:
            self._mesh, self._apart = mesh_of(self._faces), False
            self.scales["nearness"].widen(np.array([thickness]))
            for cloth in meshed:
                self.offer(cloth, "nearness")
            self._arrange()
        if apart and self._apart:
            return
        values = np.zeros(len(x))
        if not apart:
            values = thickness - vertex_distances(x, self._mesh, near_pairs(x, self._mesh, thickness), thickness)
        for cloth in meshed:
            cloth.log_field("nearness", values[cloth.piece.start : cloth.piece.stop])
        self._apart = apart

    def _contact(self, payload: bytes) -> None:
        felt = Contact.model_validate_json(payload).bodies
        if not self.window.felt:
            self.window.felt = True
            self.entities.name_curves("contact", [one.body for one in felt])
            self._arrange()
        self.entities.log_values("contact", {one.body: math.hypot(*one.force) for one in felt})

    def _touch(self, payload: bytes) -> None:
        """Show touches of the newest frame, where its positions have come before."""
        arrays, _ = decode_arrays(payload)
        vertex = read_indices("vertex", np.asarray(arrays["vertex"]).reshape(-1, 1), 1, self._vertices)[:, 0]
        if self.positions is None:
            return
        pressure = np.zeros(self._vertices)
        np.maximum.at(pressure, vertex, np.nan_to_num(np.asarray(arrays["pressure"], np.float64)))
        meshed = [cloth for cloth in self.cloths if cloth.meshed]
        if self._touches is None:
            self._touches = TouchesView(self.entities)
            for cloth in meshed:
                self.offer(cloth, "pressure")
            self._arrange()
        self._touches.log(self.positions[vertex], np.asarray(arrays["force"], np.float64).reshape(-1, 3))
        for cloth in meshed:
            cloth.log_field("pressure", pressure[cloth.piece.start : cloth.piece.stop])

    def _amounts(self, payload: bytes) -> None:
        assert self.dyed is not None
        self.dyed.take_amounts(*self._latest, payload)
        self.frames += self._dyed_object is None

    def _wear(self, picture: Picture) -> None:
        """Give the dyed object its texture."""
        for cloth in self.cloths:
            if cloth.dyed:
                cloth.log_texture(picture)

    def _picture(self, payload: bytes) -> None:
        self.entities.log(layout.YARNS, rr.EncodedImage(contents=decode_picture(payload), media_type="image/png"))
        if not self.window.pictures:
            self.window.pictures = True
            self._arrange()

    def _event(self, payload: bytes) -> None:
        event = Event.model_validate_json(payload)
        if self.dyed is not None:
            # A paused run sends no more frames: the waiting one is the present one.
            self.dyed.flush()
        level = {"error": "ERROR", "warning": "WARN"}.get(event.kind, "INFO")
        self.entities.tell(f"{event.service}: {event.message}", level)

    def _report(self, payload: bytes) -> None:
        rows = recorded_lines(json.loads(payload))
        text = "\n".join(f"| {name} | {line.replace('|', '/')} |" for name, line in rows)
        self.entities.show_page("report", f"| | |\n| --- | --- |\n{text}\n")
