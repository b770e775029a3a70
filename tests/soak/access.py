"""Nobody gets in: those without the right certificate, and those with one for something else."""

from __future__ import annotations

import json
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import nuno
from nuno.bus import credentials
from nuno.bus import credentials as certificates
from nuno.bus.credentials import Rights, read_rights
from nuno.bus.sessions import free_port, hub, spoke
from nuno.runtime import supervisor
from nuno_bench.report.page import Result
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.messages import TOPICS
from soak import scenes
from soak.processes import Processes

LONG = 4000.0
"""Simulated seconds of a run that is stopped when enough was tried."""
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
GOT = "messages read, requests taken, forgeries delivered"


class Guarded:
    """A run behind mutual TLS and access control, and an observer with a certificate.

    The observer sees what the run publishes, and what others forge; without that nothing would be proved.
    """

    def __init__(self, where: Path) -> None:
        self.where, self.certs, port = where, where / "certs", free_port()
        credentials.make(self.certs, ("localhost",), credentials.roles(), 1)
        self.endpoint, self.processes = f"tls/localhost:{port}", Processes(where)
        self.run, self.seen, self.forged, self.changed = self.processes.run, 0, 0, threading.Condition()
        listens = ("--listen", f"tls/127.0.0.1:{port}", "--config", self.config("router"))
        self.processes.supervise(scenes.sheet(where, LONG), "--no-view", *listens)
        if not self.processes.wait_for("0.00 of"):
            raise RunFailed(f"the run did not begin: {self.processes.said()}")

    def config(self, role: str) -> str:
        return str(self.certs / f"{role}.json5")

    def note(self, sample: Any) -> None:
        """Take in what the observer sees."""
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

    def stop(self) -> dict[str, Any]:
        """End the run as its operator; its report."""
        supervisor.control(self.run, self.endpoint, {"action": "stop"}, self.config("operator"))
        self.processes.wait_end(PATIENCE)
        with nuno.open(self.processes.record) as recording:
            return recording.report()


@contextmanager
def guarded_run(where: Path) -> Iterator[Guarded]:
    """A guarded run while it goes on, under observation."""
    guarded = Guarded(where)
    with guarded.processes, spoke(guarded.endpoint, guarded.config("observer")) as session:
        kept = session.declare_subscriber("nuno/*/**", guarded.note)
        yield guarded
        kept.undeclare()


def run(quick: bool, seed: int) -> list[Result]:
    """A row for each who tries, and one for each thing that must work, without which they would prove nothing."""
    del quick, seed
    with tempfile.TemporaryDirectory(prefix="nuno-access-") as name, guarded_run(Path(name)) as guarded:
        results = _what_works(guarded)
        for case, (endpoint, config) in outsiders(guarded).items():
            got = attempt(guarded, endpoint, config)
            results.append(_none(case, GOT, 0) if got is None else Result(case, GOT, "", failure="was let in"))
        for role, rights in read_rights().items():
            got = attempt(guarded, guarded.endpoint, guarded.config(role), rights)
            case = f"the {role}'s certificate, for all that is not its own"
            refused = Result(case, GOT, "", failure="was not let in at all: nothing was tried")
            results.append(refused if got is None else _none(case, GOT, sum(got)))
        results.append(_posing(guarded))
        report, case = guarded.stop(), "the run meanwhile"
    if report["state"] != "stopped":
        return [*results, Result(case, "own messages lost", "", failure=f"it ended {report['state']}")]
    return [
        *results,
        _none(case, "foreign messages that reached a service", report["refused"]),
        _none(case, "own messages lost", report["missing"]),
    ]


def _none(case: str, what: str, found: int) -> Result:
    return Result(case, what, "", (found,), bar=0, at_most=True)


def _what_works(guarded: Guarded) -> list[Result]:
    """What the same attempts give those who may."""
    read = guarded.wait()
    with spoke(guarded.endpoint, guarded.config("operator")) as session:
        taken = ask(session, guarded.run, "control")
    with spoke(guarded.endpoint, guarded.config("simulation")) as session:
        for _ in range(10):  # the hub may drop what an observer that lags is slow to take
            session.put("nuno/another/sim/state", FORGED)
            guarded.wait()
            if guarded.forged:
                break
    return [
        Result("observer", "messages read", "", (read,), bar=MESSAGES),
        Result("operator", "requests taken", "", (taken,), bar=1),
        Result("simulation", "messages delivered", "", (guarded.forged,), bar=1),
    ]


def attempt(
    guarded: Guarded, endpoint: str, config: str | None, rights: Rights | None = None
) -> tuple[int, int, int] | None:
    """Read, control and forge all that `rights` do not give: how much of each was got; None where not let in."""
    try:
        with spoke(endpoint, config) as session:
            return _try_all(guarded, session, rights or Rights())
    except BadInput:
        guarded.wait()
        return None


def _try_all(guarded: Guarded, session: Any, own: Rights) -> tuple[int, int, int]:
    heard: list[str] = []

    def hear(sample: Any) -> None:
        if sample.payload.to_bytes() not in (FORGED, b""):  # what it sends itself comes back within its own session
            heard.append(str(sample.key_expr))

    topics = [topic for topic in TOPICS if not allowed(own.reads, topic)]
    topics += [] if "**" in own.reads else ["**"]
    kept = [session.declare_subscriber(f"nuno/{guarded.run}/{name}", hear) for name in topics]
    taken = sum(ask(session, guarded.run, name) for name in QUESTIONS if not allowed(own.asks, name))
    before = guarded.forged
    header = {"run": guarded.run, "service": "simulation", "seq": 0, "frame": 1, "t": 0.02}
    for topic in (name for name in (*TOPICS, *MORE) if name not in own.publishes):
        session.put(f"nuno/{guarded.run}/{topic}", FORGED, attachment=json.dumps(header))
    session.delete(f"nuno/{guarded.run}/sim/state")
    guarded.wait()
    for subscriber in kept:
        subscriber.undeclare()
    return len(heard), taken, guarded.forged - before


def ask(session: Any, run: str, name: str) -> int:
    """Answers to a question."""
    replies = session.get(f"nuno/{run}/{name}", payload=json.dumps({"action": "status"}), timeout=ANSWER)
    return sum(reply.ok is not None for reply in replies)


def allowed(topics: tuple[str, ...], name: str) -> bool:
    """Whether key expressions of a role hold a topic."""
    return any(each in ("**", name) or (each.endswith("*") and name.startswith(each[:-1])) for each in topics)


def outsiders(guarded: Guarded) -> dict[str, tuple[str, str | None]]:
    """Endpoint and configuration of those who must not get in at all, by what they come with."""
    where = guarded.where
    credentials.make(where / "other", ("localhost",), ["operator"], 1)
    own = json.loads(Path(guarded.config("operator")).read_bytes())
    foreign = json.loads((where / "other" / "operator.json5").read_bytes())
    tls = own["transport"]["link"]["tls"]
    kept = {name: tls[name] for name in tls if name.startswith("root") or name == "verify_name_on_connect"}
    own["transport"]["link"]["tls"] = kept
    # Who signs for himself still has to be believed by the router; the router he believes.
    foreign["transport"]["link"]["tls"] |= kept
    key = (guarded.certs / "authority.key").read_bytes()
    authority = certificates.load((guarded.certs / "authority.pem").read_bytes(), key)
    old = credentials.configuration("operator", certificates.sign(authority, "operator", -1), authority)
    shown = {
        "no certificate": json.dumps(own).encode(),
        "another authority's certificate": json.dumps(foreign).encode(),
        "an expired certificate": old,
    }
    found: dict[str, tuple[str, str | None]] = {}
    for number, (case, config) in enumerate(shown.items()):
        path = where / f"outsider-{number}.json5"
        path.write_bytes(config)
        found[case] = guarded.endpoint, str(path)
    return found | {"no TLS": (guarded.endpoint.replace("tls/", "tcp/"), None)}


def _posing(guarded: Guarded) -> Result:
    """A role's certificate in the hand of one who listens in the router's place."""
    config = json.loads(Path(guarded.config("observer")).read_bytes())
    link = config["transport"]["link"]
    link["tls"] = {name.replace("connect_", "listen_"): value for name, value in link["tls"].items()}
    path, endpoint, connected = guarded.where / "posing.json5", f"tls/localhost:{free_port()}", 0
    path.write_text(json.dumps(config))
    with hub(endpoint, str(path)):
        try:
            with spoke(endpoint, guarded.config("simulation")):
                connected += 1
        except BadInput:
            pass
    return _none("the observer's certificate, in the place of the router", "services that connect", connected)
