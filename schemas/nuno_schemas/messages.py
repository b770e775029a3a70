"""Messages on the bus and in the recording: headers and small reports as JSON, arrays as bytes.

A key is `nuno/{run}/{topic}`. The header travels as the message's attachment, so the payload is
what the recording keeps and what generic tools read.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict

from nuno_schemas import SCHEMA_VERSION
from nuno_schemas.live import BodyPoses


class Described(BaseModel):
    """Base of messages: the text below a field is its description in the schema."""

    model_config = ConfigDict(use_attribute_docstrings=True)


class Header(BaseModel):
    """Who sent a message, which one it is, and when in the simulation.

    seq counts from 0 per topic without gaps; digest is the hash of the float64 state.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True)
    schema_version: int = SCHEMA_VERSION
    """Version of the message schema; any other is refused."""
    run: str
    """The run's id."""
    service: str
    """The sender."""
    seq: int
    """Number of the message, from 0 on for each topic and service: a gap means a missed message."""
    frame: int
    """Frame of the message, -1 for none."""
    t: float
    """Simulated time [s]."""
    digest: str = ""
    """Digest of the float64 state at that time."""


class FrameStatus(Described):
    """Status of a stepping service after each frame."""

    frame: int
    """Number of the frame, 0 at the start."""
    t: float
    """Simulated time [s]."""
    digest: str
    """Digest of the float64 state."""
    state: Literal["running", "paused", "done", "stopped", "diverged", "unconverged"]
    """State of the run."""
    steps: int
    """Steps of this frame."""
    step_seconds: float
    """Wall time of the frame's steps [s]."""
    paused_seconds: float = 0.0
    """Wall time for which the run has been paused so far [s]."""
    message: str = ""
    """Why the run diverged or was stopped."""


class Status(FrameStatus):
    """Simulation, once a frame."""

    energy: dict[str, float | None]
    """Energy by kind [J]: kinetic, gravitational, springs, hinges. None: not finite, which JSON cannot express."""
    stretch: float | None
    """Largest |d| / rest - 1 over the springs. None: not finite."""
    wrinkles: dict[str, float | None] = {}
    """Height and width of the ridge that each operation raised [m], by its number: 0_height."""
    counts: dict[str, int] = {}
    """Counts of the frame's steps for the report, such as touching vertices."""


class DyeStatus(FrameStatus):
    """Dye service, once a frame: amounts by dye, summed with compensation. None: not finite."""

    time: float
    """Time of the dyeing [s]: t times the dye's speed."""
    mobile: dict[str, float | None]
    """Mobile amount by dye [full cells]."""
    fixed: dict[str, float | None]
    """Amount fixed by fibre, by dye [full cells]."""
    supplied: dict[str, float]
    """Amount supplied until now, by dye [full cells]."""
    balance: float | None
    """Largest |mobile + fixed - supplied| / supplied of the dyes; 0 where none was supplied."""


class Penetration(Described):
    """Collision service, once a frame: how deep published positions lie inside bodies, and, where the scene has cloth
    contact, where cloth passes through cloth and how near it comes. Float32 positions: to a tenth of a micrometre.
    """

    frame: int
    """Frame of the positions that were checked."""
    t: float
    """Simulated time [s]."""
    depth: float
    """Largest depth [m], 0 where nothing touches."""
    vertex: int
    """Vertex of the largest depth, -1 for none."""
    inside: int
    """Vertices inside a body."""
    mean: float
    """Mean depth of those inside [m]."""
    area: float = 0.0
    """Area of cloth inside bodies [m^2], by points on every triangle, also between vertices."""
    area_depth: float = 0.0
    """Largest depth of these points [m]."""
    seconds: float
    """Wall time of the check [s]."""
    crossings: int | None = None
    """Edges of cloth that pass through triangles of cloth, or of bodies that the scene treats as cloth, and edges of
    such bodies through triangles of cloth; None if not checked.
    """
    places: list[tuple[float, float, float]] = []
    """Positions of the first of these crossings [m]."""
    objects: list[tuple[str, str]] = []
    """Object of the edge and object of the triangle, for each of these crossings."""
    distance: float | None = None
    """Least distance of an edge of cloth from a triangle of cloth without a common vertex [m], 0 for a crossing; None
    if larger than the thickness, or not checked.
    """
    thickness: float | None = None
    """Largest distance that is measured, that of the cloth contact [m]; None if not checked."""


class BodyContact(Described):
    """Forces of the cloth on a body at the end of a frame, in the world's axes."""

    body: str
    """Name of the body."""
    force: tuple[float, float, float]
    """Force of all cloth that touches the body or is attached to it [N]."""
    torque: tuple[float, float, float]
    """Torque of the same cloth about the origin of the body's first frame, of a still body about the world's [N m]."""
    attached: tuple[float, float, float]
    """The part of the force from attached cloth [N]."""
    vertices: int
    """Number of cloth vertices that touch the body."""
    area: float | None
    """Area of the cloth around these vertices [m^2]; None for a net without triangles and cells."""
    pressure: float | None
    """Largest force along the cloth's normal over area, of a vertex [Pa]."""
    mean_pressure: float | None
    """Force along the normal over area, of all these vertices together [Pa]."""


class Contact(Described):
    """Simulation, once a frame if the scene records `contact_forces`: the forces of the cloth on bodies."""

    frame: int
    """The forces are those at the end of this frame."""
    t: float
    """Simulated time [s]."""
    bodies: list[BodyContact]
    """All bodies, in the order of the scene."""


class Event(Described):
    """Something that happened to a run: control, resume, an error."""

    frame: int
    """Frame of the event, -1 for none."""
    t: float
    """Simulated time [s]."""
    service: str
    """The sender."""
    kind: Literal["control", "start", "resume", "error", "warning", "end"]
    """Kind of event."""
    text: str
    """Description of the event."""
    args: dict[str, Any] = {}
    """Arguments of a control request; details of an error or of the end."""

    @property
    def message(self) -> str:
        """The text, and of a control request what it changes, or how far it steps: set damping=0.5."""
        asked = [str(self.args[name]) for name in ("item", "frames") if self.kind == "control" and name in self.args]
        return " ".join([self.text, *asked])


class Ack(Described):
    """A service that must see every frame has handled this one."""

    service: str
    """The sender."""
    frame: int
    """The handled frame."""


@dataclass(frozen=True)
class Topic:
    """A kind of message: its name under the run, encoding, schema, whether it is recorded, when it is sent, and its
    content if the schema does not describe it.
    """

    name: str
    encoding: Literal["json", "protobuf"]
    schema: str
    recorded: bool = True
    when: str = "each frame"
    holds: str = ""


FABRIC = Topic(
    "sim/fabric", "protobuf", "nuno.Arrays", when="at the start, and where an operation changes the cloth",
    holds="`faces`, `edges` and their rest lengths, `pinned`, `uv`; in the text which vertices are which object's; at "
    "the start `settled_from` and `settled`, where cloth on coarser triangles began and came to rest",
)  # fmt: skip
STATE = Topic("sim/state", "protobuf", "foxglove.PointCloud", holds="positions, float32 about an origin")
STATUS = Topic("sim/status", "json", "nuno.Status")
CHECKPOINT = Topic(
    "sim/checkpoint",
    "protobuf",
    "nuno.Arrays",
    when="as `record.checkpoint_every` says, and at the end",
    holds="`x`, `v` and the solver's memory, float64",
)
CONTACT = Topic("sim/contact", "json", "nuno.Contact", when="each frame, where `record.contact_forces` is set")
TOUCHES = Topic(
    "sim/touches",
    "protobuf",
    "nuno.Arrays",
    when="each frame, where `record.contact_forces` is set",
    holds="of each touch `vertex`, `body`, `force` on the body [N] and `pressure` [Pa]; in the text the bodies' names",
)
GEOMETRY = Topic(
    "collision/geometry",
    "protobuf",
    "nuno.Arrays",
    when="at the start",
    holds="shapes of the bodies: capsules, meshes, fields; in the text the names of their frames",
)
BODIES = Topic(
    "collision/bodies", "protobuf", "nuno.Arrays",
    holds="`rotation` and `translation` of the bodies' frames; those at the end that do not turn have no rotation",
)  # fmt: skip
POSES = Topic(
    "poses", "json", "nuno.BodyPoses", recorded=False,
    when="as whoever moves a body says, each body on `poses/BODY`, without a header",
)  # fmt: skip
"""Sent from outside, so that it is not in TOPICS; the resulting poses are on BODIES."""
PENETRATION = Topic("collision/report", "json", "nuno.Penetration")
CLOTH = Topic("dye/cloth", "protobuf", "nuno.Arrays", when="at the start", holds="the cells of a cloth that is dyed")
CONCENTRATION = Topic(
    "dye/concentration",
    "protobuf",
    "nuno.Arrays",
    when="each frame, or as `record.dye_every` says",
    holds="`phi` and `fixed` in each cell",
)
DYE_STATUS = Topic("dye/status", "json", "nuno.DyeStatus")
DYE_CHECKPOINT = Topic(
    "dye/checkpoint",
    "protobuf",
    "nuno.Arrays",
    when="as `record.checkpoint_every` says, and at the end",
    holds="`phi`, `fixed` and the solver's memory, float64",
)
PICTURE = Topic(
    "render/image", "protobuf", "foxglove.CompressedImage", when="as `view.pictures` says", holds="a PNG file"
)
EVENT = Topic("run/event", "json", "nuno.Event", when="as they happen, each service on `run/event/SERVICE`")
REPORT = Topic(
    "run/report", "json", "nuno.Report", when="at the end, in recordings alone", holds="what `nuno run --report` prints"
)
ACK = Topic("ack", "json", "nuno.Ack", recorded=False, when="each frame, each service on `ack/SERVICE`")

TOPICS = {
    topic.name: topic
    for topic in (
        FABRIC, STATE, STATUS, CHECKPOINT, CONTACT, TOUCHES, GEOMETRY, BODIES, PENETRATION, CLOTH, CONCENTRATION,
        DYE_STATUS, DYE_CHECKPOINT, PICTURE, EVENT, REPORT, ACK,
    )
}  # fmt: skip
FRAMES = (STATE.name, CONCENTRATION.name)
"""Topics with one message a frame, which services that must see every frame acknowledge."""
STATUSES: dict[str, type[FrameStatus]] = {STATUS.name: Status, DYE_STATUS.name: DyeStatus}
CHECKPOINTS = (CHECKPOINT.name, DYE_CHECKPOINT.name)
MODELS: dict[str, type[BaseModel]] = {
    "nuno.Status": Status,
    "nuno.DyeStatus": DyeStatus,
    "nuno.Penetration": Penetration,
    "nuno.Contact": Contact,
    "nuno.BodyPoses": BodyPoses,
    "nuno.Event": Event,
    "nuno.Ack": Ack,
}
"""Models of the JSON messages, by the name of their schema."""
