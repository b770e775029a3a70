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
    """Whose fields are described by the texts below them."""

    model_config = ConfigDict(use_attribute_docstrings=True)


class Header(BaseModel):
    """Who sent a message, which one it is, and when in the simulation.

    seq counts from 0 per topic without gaps; digest is the hash of the float64 state.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True)
    schema_version: int = SCHEMA_VERSION
    """Of these messages; another one is refused."""
    run: str
    """The run's id."""
    service: str
    """By whom."""
    seq: int
    """From 0 on, of each topic and service: a number that is left out is a message that was missed."""
    frame: int
    """-1 where it belongs to none."""
    t: float
    """Simulated time [s]."""
    digest: str = ""
    """Of the float64 state that it is of."""


class FrameStatus(Described):
    """What a service that steps says of each frame."""

    frame: int
    """0 is the start."""
    t: float
    """Simulated time [s]."""
    digest: str
    """Of the float64 state."""
    state: Literal["running", "paused", "done", "stopped", "diverged", "unconverged"]
    """What becomes of the run."""
    steps: int
    """Taken for this frame."""
    step_seconds: float
    """Wall time of the frame's steps [s]."""
    message: str = ""
    """Why it diverged or was stopped."""


class Status(FrameStatus):
    """Simulation, once a frame."""

    energy: dict[str, float | None]
    """Joules by kind: kinetic, gravitational, springs, hinges. None: not finite, which JSON cannot say."""
    stretch: float | None
    """Largest |d| / rest - 1 over the springs. None: not finite."""
    wrinkles: dict[str, float | None] = {}
    """Height and width of what each change raised [m], by its number: 0_height."""


class DyeStatus(FrameStatus):
    """Dye service, once a frame: amounts by dye, summed with compensation. None: not finite."""

    time: float
    """Time of the dyeing [s]: t times the dye's speed."""
    mobile: dict[str, float | None]
    """By dye [full cells]."""
    fixed: dict[str, float | None]
    """By dye, taken by fibre [full cells]."""
    supplied: dict[str, float]
    """By dye, until now [full cells]."""
    balance: float | None
    """Largest |mobile + fixed - supplied| / supplied of the dyes; 0 where none was supplied."""


class Penetration(Described):
    """Collision service, once a frame: how deep published positions lie inside bodies, and, where the scene has cloth
    contact, where cloth passes through cloth and how near it comes. Float32 positions: to a tenth of a micrometre.
    """

    frame: int
    """Whose positions were looked at."""
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
    seconds: float
    """Wall time of the look [s]."""
    crossings: int | None = None
    """Edges of cloth that pass through triangles of cloth, or of bodies that are met as cloth is, and edges of those
    through triangles of cloth; None where that was not looked for.
    """
    places: list[tuple[float, float, float]] = []
    """Where the first of them do [m]."""
    objects: list[tuple[str, str]] = []
    """Whose edges these are, and whose triangles."""
    distance: float | None = None
    """Least distance of an edge of cloth from a triangle of cloth that it shares no vertex with [m], 0 where one passes
    through; None for more than the thickness, and where it was not looked for.
    """


class BodyContact(Described):
    """What a body feels of the cloth at the end of a frame, in the world's axes."""

    body: str
    """Its name."""
    force: tuple[float, float, float]
    """Of all cloth that touches it or is attached to it [N]."""
    torque: tuple[float, float, float]
    """The same about the origin of the body's first frame [N m]; of one that does not move, of the world."""
    attached: tuple[float, float, float]
    """The part of the force that cloth which is attached to it pulls with [N]."""
    vertices: int
    """Of the cloth, that touch it."""
    area: float | None
    """Of the cloth around these [m^2]. None: of a net without triangles and cells, which has none."""
    pressure: float | None
    """Largest force along the cloth's normal over area, of a vertex [Pa]."""
    mean_pressure: float | None
    """Of all these vertices together [Pa]."""


class Contact(Described):
    """Simulation, once a frame where the scene's record has `contact_forces`: what bodies feel."""

    frame: int
    """Whose end it is."""
    t: float
    """Simulated time [s]."""
    bodies: list[BodyContact]
    """All of the scene, in its order."""


class Event(Described):
    """Something that happened to a run: control, resume, an error."""

    frame: int
    """-1 where it belongs to none."""
    t: float
    """Simulated time [s]."""
    service: str
    """By whom."""
    kind: Literal["control", "start", "resume", "error", "warning", "end"]
    """What happened."""
    text: str
    """In words."""
    args: dict[str, Any] = {}
    """What a control request asked for; what an error or the end has to say beside its words."""


class Ack(Described):
    """A service that must see every frame has handled this one."""

    service: str
    """By whom."""
    frame: int
    """Handled."""


@dataclass(frozen=True)
class Topic:
    """A kind of message: its name under the run, encoding, whether it is recorded, when it comes, and, of what has no
    schema of its own, what it holds.
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
    "collision/bodies", "protobuf", "nuno.Arrays", holds="`rotation` and `translation` of the bodies' frames"
)
POSES = Topic(
    "poses", "json", "nuno.BodyPoses", recorded=False,
    when="as whoever moves a body says, each body on `poses/BODY`, without a header",
)  # fmt: skip
"""Comes from outside, so that it is none of TOPICS; what bodies make of it is on BODIES."""
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
"""Topics of which a run has one message a frame, and which services that must see every frame acknowledge."""
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
"""Of what is JSON, by the name of its schema."""
