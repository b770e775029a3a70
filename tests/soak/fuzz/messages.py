"""Messages of every topic, their headers, and questions: each read by the services that take them in."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import yaml

from nuno.bus.encodings import BadMessage, encode_picture
from nuno.bus.messages import Bus, Inbox, Query
from nuno.collision.bodies import build_bodies
from nuno.collision.service import Collision
from nuno.dye.painter import DyePainter
from nuno.recording.reader import Recording
from nuno.recording.writer import check_payload, topic_of
from nuno.runtime.driver import Driver, FrameWatchdog
from nuno.runtime.service import Context, Options, asks_to_finish
from nuno.scene import scene_file, yaml_lines
from nuno.scene.files import SceneFiles
from nuno.simulation.run import Simulation
from nuno.simulation.service import ClothAccount
from nuno.studio.desk import Desk
from nuno_schemas.errors import BadInput
from nuno_schemas.messages import ACK, EVENT, PICTURE, TOPICS, Ack, Header
from soak.fuzz.containers import mutate_arrays, mutate_json
from soak.fuzz.kind import Kind, Read, require, require_finite
from soak.fuzz.recordings import CLOTH, DYED, recorded

RUN = "fuzz"
PAGE = ("now", "draw", "control")
"""What is asked of the page's server."""
FRESH = 300
"""Requests after which a service is made anew: they change it."""
TEXTS: dict[str, list[dict[str, Any]]] = {
    "control": [{"action": name} for name in ("status", "pause", "resume", "step", "stop")]
    + [{"action": "step", "frames": 2}, {"action": "set", "item": "solver.dt=0.5 ms"},
       {"action": "set", "item": "gravity=[0, -1, 0]"}, {"action": "add", "item": "smooth: {object: a}"},
       {"action": "add", "item": "wrinkle: {object: a, lines: [{points: [[0,0,0],[1,0,0]], height: 1 cm}]}"}],
    "finish": [{}, {"error": "x", "discard": True, "expected": {"sim/state": 3}, "state": "done", "report": {}}],
    "poses": [{"frame": 0}, {"frame": 2}],
    "page": [{"do": "now"}, {"do": "draw", "does": "check", "start": 1, "lines": [
        {"points": [[0, 0.3, 0.3], [1, 0.3, 0.3]], "height": 0.01, "closed": False}], "settings": {"passes": 2}},
        {"do": "draw", "does": "export", "start": 1, "lines": [
            {"points": [[0, 0.5, 0.25], [1, 0.5, 0.25]], "height": -0.01}]},
        {"do": "control", "action": "pause"}, {"do": "draw", "does": "apply", "shape": 0, "lines": []}],
}  # fmt: skip


class Quiet:
    """Stands for whatever is not part of the trial: a session, a recording of a viewer, a query."""

    def __getattr__(self, name: str) -> Quiet:
        return self

    def __call__(self, *args: Any, **fields: Any) -> Quiet:
        return self

    def __enter__(self) -> Quiet:
        return self

    def __exit__(self, *exception: object) -> None: ...


class Answered(Quiet):
    """A query that keeps what it is answered."""

    def __init__(self, payload: bytes) -> None:
        self.payload = SimpleNamespace(to_bytes=lambda: payload)
        self.answers: list[bytes] = []

    def reply(self, key: str, payload: bytes) -> None:
        self.answers.append(payload)

    def reply_err(self, problem: str) -> None:
        self.answers.append(problem.encode())


def _loaded(scene: dict[str, Any]) -> scene_file.Loaded:
    data, lines = yaml_lines.parse(json.dumps(scene), "scene")
    return scene_file.load(data, lines, "scene", SceneFiles(Path(tempfile.gettempdir())))


def _context() -> Context:
    session: Any = Quiet()
    return Context(_loaded(CLOTH), Bus(session, RUN, "simulation"), Options())


def _header(folder: Path) -> Read:
    """What is no header is dropped and counted; what is one is a message."""
    session: Any = Quiet()

    def read(data: bytes) -> None:
        inbox = Inbox(Bus(session, RUN, "simulation"), [])
        sample = SimpleNamespace(
            key_expr=f"nuno/{RUN}/sim/state", attachment=SimpleNamespace(to_bytes=lambda: data),
            payload=SimpleNamespace(to_bytes=lambda: b"x"),
        )  # fmt: skip
        message = inbox._check(sample)  # type: ignore[arg-type]
        refused = sum(inbox.counts.refused.values())
        require((message is None) == (refused == 1), "a message, or one more that was refused")
        if message is None:
            raise BadMessage("refused")
        require_finite(t=message.header.t)

    return read


def _payloads(name: str, folder: Path) -> list[bytes]:
    """Of a topic, as runs have sent them."""
    if name == ACK.name:
        return [Ack(service="recorder", frame=3).model_dump_json().encode()]
    if name == PICTURE.name:
        return [encode_picture(b"\x89PNG", 0.5)]
    found: list[bytes] = []
    for data in recorded():
        path = folder / "seed.mcap"
        path.write_bytes(data)
        with Recording(path) as recording:
            topics = [name, f"{name}/*"] if name == EVENT.name else [name]
            found += [message.payload for message in recording.messages(topics)][:4]
    return found


def _message(name: str, folder: Path) -> Read:
    """As the recorder checks it, and the viewer shows it."""
    from pydantic import ValidationError

    from nuno.viewer.bridge import Bridge

    painter = DyePainter(_loaded(DYED)) if name.startswith("dye/") else None
    first = ("sim/fabric", "collision/geometry", "dye/cloth")
    before = [(other, payload) for other in first if other != name for payload in _payloads(other, folder)[:1]]
    recorder = topic_of(f"{name}/simulation" if name == EVENT.name else name)
    bridges: list[Any] = []

    def read(data: bytes) -> None:
        if name == ACK.name:
            try:
                Ack.model_validate_json(data)
            except ValidationError as error:
                raise BadMessage(str(error)) from None
            return
        if recorder is not None:
            check_payload(recorder, data)
        if not bridges:  # a message that is refused leaves what is shown as it was
            bridges.append(Bridge(Quiet(), painter=painter))
            for other, payload in before:
                bridges[0].feed(other, 0, 0.0, payload)
        bridges[0].feed(name, 1, 0.02, data)
        if name in first:
            bridges.clear()

    return read


def _asked(make: Callable[[Context], Callable[[Query], None]], folder: Path) -> Read:
    """A service that answers every question, whatever it is; made anew now and then."""
    state: dict[str, Any] = {"left": 0, "answer": None}

    def read(data: bytes) -> None:
        if not state["left"]:
            state.update(left=FRESH, answer=make(_context()))
        state["left"] -= 1
        query = Answered(data)
        state["answer"](Query("question", "key", query))  # type: ignore[arg-type]
        require(len(query.answers) == 1, "one answer to each question")

    return read


def _control(context: Context) -> Callable[[Query], None]:
    simulation = Simulation(context.loaded, None, None, 1)
    driver = Driver(context, simulation, ClothAccount(simulation, []), FrameWatchdog(context))

    def answer(question: Query) -> None:
        said = driver.control(question.json())
        question.answer_json(said)
        json.dumps(said, allow_nan=False)
        require(said["ok"] or bool(said["error"]), "done, or why not")
        require_finite(x=simulation.state.x)

    return answer


def _finish(context: Context) -> Callable[[Query], None]:
    inbox = Inbox(context.bus, [])

    def answer(question: Query) -> None:
        if asks_to_finish(inbox, question):
            question.answer_json({})

    return answer


def _poses(context: Context) -> Callable[[Query], None]:
    return Collision(context, build_bodies(context.loaded), Inbox(context.bus, [])).answer


def _page(folder: Path) -> Read:
    """What the page asks for: anything but an answer or BadInput would end a request without one."""
    desk = Desk()
    desk._starts.see(_loaded(CLOTH), "", yaml.safe_dump(CLOTH), folder / "cloth.yaml")

    def read(data: bytes) -> None:
        try:
            request = json.loads(data)
        except (ValueError, RecursionError):
            request = None
        if not isinstance(request, dict) or request.get("do") not in PAGE:  # others start processes, or write
            raise BadInput("a request is a JSON object")
        json.dumps(desk.act(request))

    return read


def _question(name: str, make: Callable[[Context], Callable[[Query], None]], follows: tuple[str, ...]) -> Kind:
    return Kind(f"question {name}", lambda folder: _texts(name), partial(_asked, make), mutate_json, follows)


def _texts(name: str) -> list[bytes]:
    return [json.dumps(text).encode() for text in TEXTS[name]]


def _topic(name: str) -> Kind:
    change = mutate_arrays if TOPICS[name].encoding == "protobuf" else mutate_json
    follows = ("nuno.bus.encodings", "nuno.collision.messages", "nuno_schemas.messages", "nuno.viewer.bridge",
               "nuno.dye.painter", "nuno.viewer.dyed")  # fmt: skip
    return Kind(f"message {name}", partial(_payloads, name), partial(_message, name), change, follows, (BadMessage,))


UNDECODED = ("sim/checkpoint", "dye/checkpoint")
"""Topics that no service takes in but the recorder, which checks their frame alone; MCAP has them decoded."""
HEADERS = [
    Header(run=RUN, service="simulation", seq=seq, frame=1, t=0.02, digest="ab").model_dump_json().encode()
    for seq in (0, 3)
]
MESSAGES = (
    Kind("message header", lambda folder: HEADERS, _header, mutate_json, ("nuno.bus.messages",), (BadMessage,)),
    *(_topic(name) for name in TOPICS if name not in UNDECODED),
    _question("control", _control, ("nuno.runtime.driver", "nuno.simulation.service")),
    _question("finish", _finish, ("nuno.runtime.service",)),
    _question("poses", _poses, ("nuno.collision.service",)),
    Kind(
        "page request",
        lambda folder: _texts("page"),
        _page,
        mutate_json,
        ("nuno.studio.lines", "nuno.studio.draw"),
    ),
)
