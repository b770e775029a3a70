"""What somebody gets from a guarded run who tries everything that is not his."""

from __future__ import annotations

import json
import threading
from dataclasses import dataclass, field
from typing import Any

from nuno.access.rights import Rights
from nuno.wire.sessions import spoke
from nuno_bench.soak.access.guarded import Guarded
from nuno_schemas.errors import BadInput
from nuno_schemas.messages import TOPICS

FORGED = b"forged"
MESSAGES = 20
"""How many messages the run publishes meanwhile, at least: what a reader could have had."""
ANSWER = 1.0
"""How long an answer to a control request is waited for [s]; the run's own comes within milliseconds."""
PATIENCE = 30.0
MORE = ("run/event/simulation", "ack/recorder", "ack/collision", "**")
"""Keys to forge beside the topics."""
QUESTIONS = (
    "control", "control/dye", "finish/simulation", "finish/recorder", "sim/ask/now", "collision/ask/geometry",
    "premises/simulation",
)  # fmt: skip


@dataclass
class Tally:
    """What was got."""

    connected: bool = False
    read: int = 0
    taken: int = 0
    forged: int = 0
    """Messages that others received from somebody who may not publish them."""

    @property
    def total(self) -> int:
        return self.read + self.taken + self.forged


@dataclass
class Witness:
    """An observer with a certificate: sees what the run publishes, and what others forge."""

    guarded: Guarded
    session: Any
    seen: int = 0
    forged: int = 0
    changed: threading.Condition = field(default_factory=threading.Condition)

    def __post_init__(self) -> None:
        self._kept = self.session.declare_subscriber("nuno/*/**", self._note)

    def _note(self, sample: Any) -> None:
        forged = sample.payload.to_bytes() == FORGED
        with self.changed:
            self.forged += forged
            self.seen += not forged
            self.changed.notify_all()

    def wait(self, messages: int = MESSAGES) -> int:
        """Until the run has published so many more; how many it did. Raises TimeoutError."""
        with self.changed:
            begin = self.seen
            if not self.changed.wait_for(lambda: self.seen - begin >= messages, PATIENCE):
                raise TimeoutError("the observer sees nothing: nothing else here would prove anything")
            return self.seen - begin


def attempt(witness: Witness, endpoint: str, config: str | None, rights: Rights | None = None) -> Tally:
    """Read, control and forge all that `rights` do not give."""
    own = rights or Rights()
    tally = Tally()
    try:
        with spoke(endpoint, config) as session:
            tally.connected = True
            _try_all(witness, session, own, tally)
    except BadInput:
        witness.wait()
    return tally


def _try_all(witness: Witness, session: Any, own: Rights, tally: Tally) -> None:
    run = witness.guarded.run
    heard: list[str] = []

    def hear(sample: Any) -> None:
        if sample.payload.to_bytes() not in (FORGED, b""):  # what it sends itself comes back within its own session
            heard.append(str(sample.key_expr))

    topics = [topic for topic in TOPICS if not allowed(own.reads, topic)]
    if "**" not in own.reads:
        topics.append("**")
    kept = [session.declare_subscriber(f"nuno/{run}/{name}", hear) for name in topics]
    for name in (name for name in QUESTIONS if not allowed(own.asks, name)):
        tally.taken += ask(session, run, name)
    before = witness.forged
    header = {"run": run, "service": "simulation", "seq": 0, "frame": 1, "t": 0.02}
    for topic in (name for name in (*TOPICS, *MORE) if name not in own.publishes):
        session.put(f"nuno/{run}/{topic}", FORGED, attachment=json.dumps(header))
    session.delete(f"nuno/{run}/sim/state")
    witness.wait()
    tally.forged = witness.forged - before
    tally.read = len(heard)
    for subscriber in kept:
        subscriber.undeclare()


def ask(session: Any, run: str, name: str, action: str = "status") -> int:
    """Answers to a question."""
    replies = session.get(f"nuno/{run}/{name}", payload=json.dumps({"action": action}), timeout=ANSWER)
    return sum(reply.ok is not None for reply in replies)


def allowed(topics: tuple[str, ...], name: str) -> bool:
    """Whether key expressions of a role hold a topic."""
    return any(each in ("**", name) or (each.endswith("*") and name.startswith(each[:-1])) for each in topics)
