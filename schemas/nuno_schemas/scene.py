"""A scene: the description of a simulation, written in YAML, validated before anything starts. SI inside."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator, model_validator
from pydantic_core import PydanticCustomError

from nuno_schemas.dyeing import Dyeing
from nuno_schemas.errors import nearest
from nuno_schemas.parts import AUTO, Accuracy, Choice, Colour, Interval, Metres, Name, Part, Solver, require_distinct
from nuno_schemas.units import Plausible, quantity

# The part of a scene that describes its pictures.

Angle = Annotated[float, quantity("rad")]
Distance = Annotated[float, quantity("m", gt=0)]

Vector = tuple[Metres, Metres, Metres]
Pixels = Annotated[int, Field(ge=16, le=8192)]


class View(Part):
    """Camera and colours of pictures; omitted fields are fitted to the scene."""

    azimuth: Angle = Field(default=0.6, description="[rad] round the vertical, 0 looks along -z")
    elevation: Angle = Field(default=0.2, description="[rad] of the eye above the horizon")
    target: Vector | None = Field(default=None, description="what is looked at: x, y, z [m]; fitted unless given")
    distance: Distance | None = Field(default=None, description="of the eye from the target [m]; fitted unless given")
    close: bool = Field(default=False, description="whether pictures are fitted to the cloth alone, whatever it is on")
    size: tuple[Pixels, Pixels] = Field(default=(960, 720), description="width and height in pixels")
    colour: Literal["cloth", "stretch"] = Field(
        default="cloth",
        description="how cloth of triangles is painted that has neither a colour nor a texture: each object in a "
        "colour by its place in the scene, or by stretch",
    )
    links: Literal["stretch", "yarn", "tension"] = Field(
        default="stretch",
        description="what colours the links of a net in the viewer: stretch, the yarn they are of, or its tension",
    )
    yarns: Choice | None = Field(
        default=None, description="how `nuno export --style` and `pictures` draw yarns: a plugin and its fields"
    )
    pictures: Interval | Literal["end"] | None = Field(
        default=None,
        description="yarns drawn by rays while the scene runs, shown and recorded: at this interval [s], beside those "
        "of the first and the last frame, or at the end alone; left out: none",
    )


Moment = Annotated[float, quantity("s", ge=0)]
Duration = Annotated[float, quantity("s", gt=0, le=1e9)]
Rate = Annotated[float, quantity("Hz", gt=0, le=100_000)]
Stiffness = Annotated[float, quantity("N/m", gt=0)]
Acceleration = Annotated[float, quantity("m/s^2")]
Damping = Annotated[float, quantity("1/s", ge=0)]
Roughness = Annotated[float, quantity("m", Plausible(0.0, 0.01, ("mm", "um")), ge=0)]


class Object(Part):
    """A piece of cloth."""

    name: Name = Field(description="of the piece; no other has it")
    model: Choice = Field(description="what builds it: a plugin and its fields")
    roughness: Roughness = Field(default=0.0, description="root mean square of an unevenness it starts with [m]")
    colour: Colour | None = Field(default=None, description="#rrggbb or a CSS name; left out: as `view.colour` says")


class Body(Part):
    """Something that the cloth collides with."""

    name: Name = Field(description="of the body; no other has it")
    collider: Choice = Field(description="its shape: a plugin and its fields")
    motion: Choice | None = Field(default=None, description="left out: the body does not move")
    contact: Choice | None = Field(default=None, description="with the cloth; the scene's where it is left out")
    stiffness: Stiffness | Literal["auto"] = Field(
        default="auto", description="of the contact, for each cloth vertex [N/m]; auto: what the cloth can bear"
    )
    damping: float = Field(default=0.5, ge=0, le=10, description="normal damping in contact, as a ratio of critical")
    friction: float = Field(
        default=0.3, ge=0, le=100, description="Coulomb coefficient; penalty contact gives way a little first"
    )


class Applied(Choice):
    """An operation that changes a piece of cloth during the scene, or arranges all cloth before its start."""

    at: Moment = Field(default=0.0, description="when [s]; the frame nearest to it is the last without")
    object: Name | None = Field(
        default=None, description="the object that is changed; left out: the only one, or all by untangle"
    )


class ClothContact(Choice):
    """Contact between cloth and cloth; `cloth_contact: NAME` is short for `cloth_contact: {plugin: NAME}`."""

    allow: list[tuple[Name, Name]] = Field(
        default_factory=list, description="objects that may pass through each other, in pairs; one through itself, too"
    )
    bodies: list[Name] | Literal["auto"] = Field(
        default_factory=list,
        description="bodies of triangles that cloth meets as it meets cloth, and never passes through with any edge; "
        "with a body's own friction and damping, and in the place of its contact; auto: the skins without a contact of "
        "their own, which accuracy: preview gives `sliding` instead, unless one of their frames carries cloth",
        examples=[["wearer"]],
    )

    @model_validator(mode="before")
    @classmethod
    def _by_name(cls, value: Any) -> Any:
        return {"plugin": value} if isinstance(value, str) and value != "none" else value


CHECKPOINT_FRAMES = 60
"""Frames from one checkpoint to the next, unless the scene says otherwise.

A checkpoint of cloth has 76 bytes a vertex, and a frame 12: checkpoints add about a tenth to a recording, and a killed
run loses at most this many frames. They are taken by scene time, not by the clock, so that cloth and its dye have the
same ones, and equal runs make equal recordings.
"""


class Record(Part):
    """The content of the recording."""

    checkpoint_every: Interval | None = Field(
        default=None,
        description=f"interval of float64 checkpoints [s], {CHECKPOINT_FRAMES} frames unless given; the last state is "
        "always kept",
    )
    dye_every: Interval | None = Field(
        default=None,
        description="interval of the amounts of dye that are recorded and shown [s], of all frames unless given; "
        "beside the first, the last and those of checkpoints",
    )
    contact_forces: bool = Field(
        default=False, description="whether the force and pressure on each body are found in each frame, and recorded"
    )


MOVING = ("objects", "bodies", "forces", "operations", "solver", "until", "rest_speed", "cloth_contact")
"""Fields of scenes with moving cloth, which a scene of dye alone must not set."""


class Fading(Part):
    """Damping that is strong at first and fades: last + (first - last) / (1 + t / over)^2 at time t."""

    first: Damping = Field(description="at the start [1/s]")
    over: Annotated[float, quantity("s", gt=0)] = Field(description="in this time it falls to a quarter [s]")
    last: Damping = Field(default=0.0, description="what it fades to [1/s]")

    def mean(self, start: float, end: float) -> float:
        """Return the mean from `start` to `end` [s]. A rational law, unlike exp, has the same bits on every machine."""
        return self.last + (self.first - self.last) / ((1.0 + start / self.over) * (1.0 + end / self.over))


class Scene(Part):
    """The whole scene. Quantities carry units ("1 ms", "27 N/m"); a bare number is SI."""

    nuno: Literal[1] = Field(description="scene schema version")
    name: Name = Field(description="of the scene, and of its recordings")
    description: str = Field(default="", description="what it shows, in a sentence")
    duration: Duration = Field(description="simulated time [s], whole frames of it")
    until: Literal["duration", "rest", "balance"] = Field(
        "duration",
        description="rest: end before `duration` where the cloth rests, see rest_speed; balance: end where surfaces "
        "and friction leave every vertex no more force than a thousandth of the springs' mean tension, and fail short "
        "of that",
    )
    rest_speed: Annotated[float, quantity("m/s", gt=0)] | None = Field(
        default=None,
        description="cloth rests where no vertex has gone farther in 0.3 s than at this speed, but for trembling; not "
        "given: 2e-4 of the cloth's size a second [m/s]",
    )
    frame_rate: Rate = Field(default=60.0, description="frames that are published and recorded per second [Hz]")
    frame_limit: Annotated[float, quantity("s", gt=0)] | None = Field(
        default=None,
        description="longest wall time of a frame [s]: one that takes longer ends the run as failed, with what it has "
        "recorded; not given: none",
    )
    solver: Solver = Field(
        default=Solver(plugin=AUTO),
        description="the integrator, a plugin with its fields, and its step; auto: chosen for the scene and `accuracy`",
    )
    accuracy: Accuracy | None = Field(
        default=None,
        description="what the step is chosen for: positions off by a hundredth (preview), a thousandth (normal) or a "
        "ten-thousandth (reference) of the cloth's size, dye of the largest amount; normal where the solver is auto",
    )
    allow_unstable: bool = Field(default=False, description="accept a step above the stability limit")
    gravity: tuple[Acceleration, Acceleration, Acceleration] = Field(
        default=(0.0, -9.81, 0.0), description="x, y, z [m/s^2]; y is up"
    )
    damping: Damping | Literal["auto"] | Fading = Field(
        default=0.0,
        description="viscous, per unit mass [1/s]; auto, with until: balance: what leads to rest soonest; or one that "
        "fades, for cloth that starts out of balance",
    )
    seed: int = Field(default=0, ge=0, lt=2**63, description="of all that plugins choose at random")
    objects: list[Object] = Field(default_factory=list, max_length=1000, description="pieces of cloth")
    bodies: list[Body] = Field(default_factory=list, max_length=1000, description="what the cloth meets")
    forces: list[Choice] = Field(
        default_factory=list, max_length=1000, description="beyond springs, gravity and damping, in their order"
    )
    operations: list[Applied] = Field(
        default_factory=list,
        max_length=1000,
        description="what changes the cloth: wrinkle while the scene goes on, untangle before",
    )
    contact: Choice = Field(
        default=Choice(plugin="penalty"), description="between cloth and the bodies that name none",
        examples=[{"plugin": "penalty"}],
    )  # fmt: skip
    cloth_contact: ClothContact | Literal["none"] = Field(
        default="none", description="of cloth with itself and with other cloth; none: it passes through"
    )
    dye: Dyeing | None = Field(default=None, description="a cloth that is dyed; alone, or on an object")
    record: Record = Field(default=Record(), description="what goes into the recording beside every frame")
    view: View = Field(default=View(), description="how pictures are taken")

    @field_validator("objects", "bodies")
    @classmethod
    def _names_differ(cls, parts: list[Any]) -> list[Any]:
        return require_distinct(parts)

    @model_validator(mode="after")
    def _objects_are_there(self) -> Scene:
        names = [part.name for part in self.objects]
        named: list[tuple[str, tuple[str | int, ...]]] = [
            (applied.object, ("operations", i, "object"))
            for i, applied in enumerate(self.operations)
            if applied.object is not None
        ]
        if self.dye is not None and self.dye.object is not None:
            named.append((self.dye.object, ("dye", "object")))
        if isinstance(self.cloth_contact, ClothContact):
            pairs = enumerate(self.cloth_contact.allow)
            named += [(name, ("cloth_contact", "allow", i, k)) for i, pair in pairs for k, name in enumerate(pair)]
            self._check_met(self.cloth_contact.bodies)
        for name, place in named:
            if name not in names:
                problem = "no object has this name; {known}"
                raise PydanticCustomError("no_object", problem, {"known": nearest(name, names), "inside": place})
        for i, applied in enumerate(self.operations):
            if applied.at > self.duration:
                context = {"end": f"{self.duration:g}", "inside": ("operations", i, "at")}
                problem = "the scene ends before, at {end} s; lengthen it, or apply this earlier"
                raise PydanticCustomError("too_late", problem, context)
        return self

    def _check_met(self, names: list[str] | Literal["auto"]) -> None:
        """Check that bodies in `cloth_contact` exist, are listed once, and have no contact of their own."""
        bodies = {body.name: body for body in self.bodies}
        for i, name in enumerate(names if names != "auto" else ()):
            place = ("cloth_contact", "bodies", i)
            if name not in bodies:
                context = {"known": nearest(name, list(bodies)), "inside": place}
                raise PydanticCustomError("no_body", "no body has this name; {known}", context)
            if name in names[:i]:
                raise PydanticCustomError("same_body", "this body is named twice", {"inside": place})
            if bodies[name].contact is not None:
                problem = "this body has a contact of its own; leave that out, or the body out here"
                raise PydanticCustomError("two_contacts", problem, {"inside": place})

    @model_validator(mode="after")
    def _dye_alone(self) -> Scene:
        for name in () if self.moves else MOVING:
            if getattr(self, name) != type(self).model_fields[name].get_default(call_default_factory=True):
                problem = (
                    "a cloth that is dyed by itself does not move; leave `{part}` or `dye` out, or name the "
                    "object that is dyed as dye.object"
                )
                raise PydanticCustomError("dye_alone", problem, {"part": name, "inside": (name,)})
        return self

    @model_validator(mode="after")
    def _one_step(self) -> Scene:
        if self.accuracy is not None and self.solver.dt != "auto":
            problem = "accuracy chooses the step, and solver.dt gives it; leave one of them out"
            raise PydanticCustomError("step_and_accuracy", problem, {"inside": ("accuracy",)})
        if self.accuracy is not None and not self.moves and self.dye is not None and self.dye.solver.plugin != AUTO:
            problem = "accuracy chooses the solver of the dye, and dye.solver names it; leave one of them out"
            raise PydanticCustomError("dye_accuracy", problem, {"inside": ("accuracy",)})
        return self

    @model_validator(mode="after")
    def _bodies_to_feel(self) -> Scene:
        if self.record.contact_forces and not self.bodies:
            problem = "there are no bodies that could feel anything; give the scene some, or leave this out"
            raise PydanticCustomError("no_bodies", problem, {"inside": ("record", "contact_forces")})
        return self

    @model_validator(mode="after")
    def _rests_at_all(self) -> Scene:
        if self.rest_speed is not None and self.until != "rest":
            problem = "this tells when cloth rests, and the scene does not end there; give until: rest, or leave it out"
            raise PydanticCustomError("no_rest", problem, {"inside": ("rest_speed",)})
        return self

    @model_validator(mode="after")
    def _damped_to_rest(self) -> Scene:
        if self.damping == "auto" and self.until != "balance":
            problem = "auto leads to rest, and changes how the cloth moves; give a number, or until: balance"
            raise PydanticCustomError("damped_to_rest", problem, {"inside": ("damping",)})
        return self

    @property
    def moves(self) -> bool:
        """Whether the scene has moving cloth: all scenes do, except those of dye alone."""
        return self.dye is None or self.dye.object is not None

    @property
    def meets(self) -> bool:
        """Whether cloth collides with cloth."""
        return self.moves and self.cloth_contact != "none"

    def meet(self) -> NDArray[np.bool_]:
        """Return which objects collide with each other and with themselves, shape (o, o)."""
        names = [part.name for part in self.objects]
        collide = np.full((len(names), len(names)), self.meets)
        for one, other in self.cloth_contact.allow if isinstance(self.cloth_contact, ClothContact) else ():
            a, b = names.index(one), names.index(other)
            collide[a, b] = collide[b, a] = False
        return collide

    @property
    def met_bodies(self) -> list[int]:
        """Numbers of the bodies that the cloth contact treats as cloth."""
        names = self.cloth_contact.bodies if self.meets and isinstance(self.cloth_contact, ClothContact) else ()
        if names == "auto":
            return [i for i in self._own_skins if i not in self.slid_skins]
        return [i for i, body in enumerate(self.bodies) if body.name in names]

    @property
    def slid_skins(self) -> list[int]:
        """Numbers of the skins that the scene leaves open how to meet, and that are met by sliding contact for a
        preview. A skin with cloth attached to one of its frames is not among them: it bends, and enters that cloth.
        """
        attached = [model.config.get("attach") for model in (piece.model for piece in self.objects)]
        carrying = [one.get("body") for one in attached if isinstance(one, dict) and one.get("frame") is not None]
        return [i for i in self._own_skins if self.accuracy == "preview" and self.bodies[i].name not in carrying]

    @property
    def _own_skins(self) -> list[int]:
        """Numbers of skins without a contact of their own, if the cloth contact has `bodies: auto`."""
        if not (self.meets and isinstance(self.cloth_contact, ClothContact) and self.cloth_contact.bodies == "auto"):
            return []
        return [
            i
            for i, body in enumerate(self.bodies)
            if body.collider.plugin in ("skin", "surface") and body.contact is None
        ]

    @property
    def step_undecided(self) -> bool:
        """Whether the solver of moving cloth, or its step, has yet to be chosen."""
        return self.moves and (self.solver.plugin == AUTO or self.accuracy is not None)

    @property
    def undecided(self) -> bool:
        """Whether any solver or its step has yet to be chosen."""
        return self.step_undecided or (self.dye is not None and self.dye.solver.plugin == AUTO)

    @property
    def frames(self) -> int:
        """Number of whole frames in the duration, at least one."""
        return self.in_frames(self.duration)

    @property
    def checkpoint_frames(self) -> int:
        """Frames from one checkpoint to the next."""
        every = self.record.checkpoint_every
        return CHECKPOINT_FRAMES if every is None else self.in_frames(every)

    def in_frames(self, seconds: float) -> int:
        """Return a time [s] as a whole number of frames, at least one."""
        return max(1, round(float(seconds * self.frame_rate)))
