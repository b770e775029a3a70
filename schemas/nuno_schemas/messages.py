"""Messages on the bus and in the recording: headers and small reports as JSON, arrays as bytes.

A key is `nuno/{run}/{topic}`. The header travels as the message's attachment, so the payload is
what the recording keeps and what generic tools read.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict

from nuno_schemas import SCHEMA_VERSION


class Header(BaseModel):
    """Who sent a message, which one it is, and when in the simulation.

    seq counts from 0 per topic without gaps; digest is the hash of the float64 state.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)
    schema_version: int = SCHEMA_VERSION
    run: str
    service: str
    seq: int
    frame: int
    t: float
    digest: str = ""


class FrameStatus(BaseModel):
    """What a service that steps says of each frame."""

    frame: int
    t: float
    digest: str
    state: Literal["running", "paused", "done", "stopped", "diverged", "unconverged"]
    steps: int
    step_seconds: float
    """Wall time of the frame's steps [s]."""
    message: str = ""


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
    fixed: dict[str, float | None]
    supplied: dict[str, float]
    balance: float | None
    """Largest |mobile + fixed - supplied| / supplied of the dyes; 0 where none was supplied."""


class Penetration(BaseModel):
    """Collision service, once a frame: how deep published positions lie inside bodies, and, where the scene has cloth
    contact, where cloth passes through cloth and how near it comes. Float32 positions: to a tenth of a micrometre.
    """

    frame: int
    t: float
    depth: float
    """Largest depth [m], 0 where nothing touches."""
    vertex: int
    """Vertex of the largest depth, -1 for none."""
    inside: int
    """Vertices inside a body."""
    mean: float
    """Mean depth of those inside [m]."""
    seconds: float
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


class Event(BaseModel):
    """Something that happened to a run: control, resume, an error."""

    frame: int
    t: float
    service: str
    kind: Literal["control", "start", "resume", "error", "warning", "end"]
    text: str
    args: dict[str, Any] = {}


class Ack(BaseModel):
    """A service that must see every frame has handled this one."""

    service: str
    frame: int


@dataclass(frozen=True)
class Topic:
    """A kind of message: its name under the run, encoding, and whether it is recorded."""

    name: str
    encoding: Literal["json", "protobuf"]
    schema: str
    recorded: bool = True


FABRIC = Topic("sim/fabric", "protobuf", "nuno.Arrays")
STATE = Topic("sim/state", "protobuf", "foxglove.PointCloud")
STATUS = Topic("sim/status", "json", "nuno.Status")
CHECKPOINT = Topic("sim/checkpoint", "protobuf", "nuno.Arrays")
GEOMETRY = Topic("collision/geometry", "protobuf", "nuno.Arrays")
BODIES = Topic("collision/bodies", "protobuf", "nuno.Arrays")
PENETRATION = Topic("collision/report", "json", "nuno.Penetration")
CLOTH = Topic("dye/cloth", "protobuf", "nuno.Arrays")
CONCENTRATION = Topic("dye/concentration", "protobuf", "nuno.Arrays")
DYE_STATUS = Topic("dye/status", "json", "nuno.DyeStatus")
DYE_CHECKPOINT = Topic("dye/checkpoint", "protobuf", "nuno.Arrays")
PICTURE = Topic("render/image", "protobuf", "foxglove.CompressedImage")
EVENT = Topic("run/event", "json", "nuno.Event")
REPORT = Topic("run/report", "json", "nuno.Report")
ACK = Topic("ack", "json", "nuno.Ack", recorded=False)

TOPICS = {
    topic.name: topic
    for topic in (
        FABRIC, STATE, STATUS, CHECKPOINT, GEOMETRY, BODIES, PENETRATION, CLOTH, CONCENTRATION, DYE_STATUS,
        DYE_CHECKPOINT, PICTURE, EVENT, REPORT, ACK,
    )
}  # fmt: skip
FRAMES = (STATE.name, CONCENTRATION.name)
"""Topics of which a run has one message a frame, and which services that must see every frame acknowledge."""
STATUSES: dict[str, type[FrameStatus]] = {STATUS.name: Status, DYE_STATUS.name: DyeStatus}
CHECKPOINTS = (CHECKPOINT.name, DYE_CHECKPOINT.name)
