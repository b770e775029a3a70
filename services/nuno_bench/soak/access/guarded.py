"""A run behind mutual TLS and access control, and the certificates of everybody who tries to get in."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from nuno.access import certificates, folder
from nuno.scene import scene_file
from nuno.service import Options
from nuno.supervision import runs, supervisor
from nuno.supervision.supervisor import Deployment, Outcome
from nuno.wire.sessions import free_port
from nuno_bench.soak import small
from nuno_schemas.messages import FrameStatus

LONG = 4000.0
"""Simulated seconds of a run that is stopped when enough was tried."""


@dataclass
class Guarded:
    """A run that goes on, its endpoint, and the folder of its certificates."""

    run: str
    endpoint: str
    certs: Path
    recording: Path
    moved: threading.Event = field(default_factory=threading.Event)
    outcome: Outcome | None = None

    def config(self, role: str) -> str:
        return str(self.certs / f"{role}.json5")

    def control(self, action: str) -> dict[str, object]:
        return supervisor.control(self.run, self.endpoint, {"action": action}, self.config("operator"))


@contextmanager
def guarded_run(where: Path) -> Iterator[Guarded]:
    """A run whose hub listens with TLS, while it goes on; it is stopped at the end."""
    certs, run = where / "certs", runs.new_id("guarded")
    folder.make(certs, ("localhost",), folder.roles(), 1)
    guarded = Guarded(run, f"tls/localhost:{free_port()}", certs, where / "guarded.mcap")
    loaded = scene_file.read(small.write(where, LONG))

    def note(status: FrameStatus | str) -> None:
        if isinstance(status, FrameStatus) and status.frame > 0:
            guarded.moved.set()

    def body() -> None:
        listens = guarded.endpoint.replace("localhost", "127.0.0.1")
        deployment = Deployment(listen=listens, run=run, config=guarded.config("router"))
        guarded.outcome = supervisor.supervise(loaded, Options(record=guarded.recording), deployment, note)

    thread = threading.Thread(target=body, daemon=True)
    thread.start()
    if not guarded.moved.wait(300.0):
        raise TimeoutError("the run did not begin")
    try:
        yield guarded
    finally:
        guarded.control("stop")
        thread.join(60.0)


def outsiders(guarded: Guarded, where: Path) -> dict[str, tuple[str, str | None]]:
    """Endpoint and configuration of those who must not get in at all, by what they come with."""
    other = where / "other"
    folder.make(other, ("localhost",), ["operator"], 1)
    own = json.loads(Path(guarded.config("operator")).read_bytes())
    tls = own["transport"]["link"]["tls"]
    kept = {name: tls[name] for name in tls if name.startswith("root") or name == "verify_name_on_connect"}
    own["transport"]["link"]["tls"] = kept
    bare = where / "bare.json5"
    bare.write_text(json.dumps(own))
    # Who signs for himself still has to be believed by the router; the router he believes.
    foreign = json.loads((other / "operator.json5").read_bytes())
    foreign["transport"]["link"]["tls"] |= kept
    (where / "foreign.json5").write_text(json.dumps(foreign))
    authority = certificates.load((guarded.certs / "authority.pem").read_bytes(), _key(guarded))
    old = folder.configuration("operator", certificates.sign(authority, "operator", -1), authority)
    (where / "old.json5").write_bytes(old)
    return {
        "no certificate": (guarded.endpoint, str(bare)),
        "another authority's certificate": (guarded.endpoint, str(where / "foreign.json5")),
        "an expired certificate": (guarded.endpoint, str(where / "old.json5")),
        "no TLS": (guarded.endpoint.replace("tls/", "tcp/"), None),
    }


def _key(guarded: Guarded) -> bytes:
    return (guarded.certs / "authority.key").read_bytes()


def posing_router(guarded: Guarded, where: Path, role: str) -> Path:
    """A configuration by which a role's certificate is shown by one who listens."""
    config = json.loads(Path(guarded.config(role)).read_bytes())
    link = config["transport"]["link"]
    link["tls"] = {name.replace("connect_", "listen_"): value for name, value in link["tls"].items()}
    path = where / f"posing-{role}.json5"
    path.write_text(json.dumps(config))
    return path
