"""zenoh sessions that expose nothing: loopback unless told otherwise, no scouting.

What a run must not lose is sent with blocking congestion control. zenoh blocks for a limited time, then closes the
session of whoever does not read; and one that does not read holds up all others of its hub. So the limit is longer
than a run waits for its services, and the hub blocks for the services of its run only: to everyone else it passes on
what they keep up with.
"""

from __future__ import annotations

import atexit
import hashlib
import json
import socket
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from typing import Any

import zenoh

from nuno_schemas.errors import BadInput

PATIENCE = 120.0
"""How long [s] a run waits for a service that it cannot do without and that neither answers nor ends."""
SILENCE_SECONDS = 1.25 * PATIENCE
"""A session that is silent, or does not read, this long is closed: after whoever waits for it has said so.

A process that ends closes its connections, which is noticed at once; only a host that vanishes takes this long. A
shorter time would take a service that is stopped for a while, or pages to a slow disk, for a dead one.
"""
QUEUED_BATCHES = 16
"""Batches of 64 KiB that wait for a session, at most (16 is zenoh's most): what a slow reader may lag behind."""

HANDOVER = 3.0
"""How long [s] a session waits for one of its identity to end, once the hub answers."""

LINGER = 0.1
"""So long [s] Python waits when it ends: see `_closing`."""

ATTEMPTS = 20
"""Free ports that are tried: between finding one and listening there another run may take it."""


class PortTaken(BadInput):
    """Another program listens at the endpoint."""


def free_port() -> int:
    """A TCP port on loopback that is free now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def identity(run: str, service: str) -> str:
    """The zenoh id of a service's session: its hub knows it from anyone else's."""
    return "6e" + hashlib.blake2b(f"{run}/{service}".encode(), digest_size=15).hexdigest()


def _favour(trusted: Sequence[str]) -> list[dict[str, Any]]:
    """Rules of a hub that waits for the sessions of `trusted` (identities), and for no other, to take messages."""

    def rule(control: str, **whom: Any) -> dict[str, Any]:
        what = {"messages": ["put"], "key_exprs": ["nuno/**"], "flows": ["egress"]}
        return whom | what | {"overwrite": {"congestion_control": control}}

    return [rule("drop"), *([rule("block", zids=list(trusted))] if trusted else [])]


def _config(mode: str, listen: list[str], connect: list[str], extra: str | None) -> zenoh.Config:
    try:
        config = zenoh.Config.from_file(extra) if extra else zenoh.Config()
    except (zenoh.ZError, OSError) as error:
        remedy = "give a zenoh configuration file (JSON5)"
        raise BadInput(f"cannot be read: {_short(error)}", field="--config", value=extra, remedy=remedy) from None
    settings: dict[str, Any] = {
        "mode": mode,
        "listen/endpoints": listen,
        "connect/endpoints": connect,
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        # Nobody is scouted for, so nothing is gained by waiting half a second for an answer.
        "scouting/delay": 0,
        "transport/link/tx/lease": round(1e3 * SILENCE_SECONDS),
        "transport/link/tx/queue/congestion_control/block/wait_before_close": round(1e6 * SILENCE_SECONDS),
        "transport/link/tx/queue/size/data": QUEUED_BATCHES,
    }
    for key, value in settings.items():
        try:
            config.insert_json5(key, json.dumps(value))
        except zenoh.ZError:
            raise BadInput("not an endpoint", value=value[0], remedy="for example tcp/127.0.0.1:7447") from None
    return config


@contextmanager
def hub(endpoint: str, extra: str | None = None, trusted: Sequence[str] | None = None) -> Iterator[zenoh.Session]:
    """A session that others connect to, e.g. "tcp/127.0.0.1:7447". Raises PortTaken, BadInput.

    `extra` is a zenoh configuration file (TLS, access control) that is read first. `trusted` are the identities of
    those that messages are held back for until they take them; None: of everyone.
    """
    config = _config("router", [endpoint], [], extra)
    if trusted is not None:
        config.insert_json5("qos/network", json.dumps(json.loads(config.get_json("qos/network")) + _favour(trusted)))
    try:
        session = _open(config)
    except zenoh.ZError as error:
        if "in use" in str(error):
            remedy = "choose another port: --listen tcp/127.0.0.1:PORT"
            raise PortTaken("another program listens there", value=endpoint, remedy=remedy) from None
        remedy = "check the endpoint"
        raise BadInput(f"cannot listen: {_short(error)}", value=endpoint, remedy=remedy) from None
    with _closing(session):
        yield session


@contextmanager
def hub_at(
    listen: str | None, extra: str | None = None, trusted: Sequence[str] | None = None
) -> Iterator[tuple[zenoh.Session, str]]:
    """A hub and its endpoint: the one given, or a free port of loopback. Raises as `hub`."""
    with ExitStack() as stack:
        for left in reversed(range(1 if listen else ATTEMPTS)):
            endpoint = listen or f"tcp/127.0.0.1:{free_port()}"
            try:
                session = stack.enter_context(hub(endpoint, extra, trusted))
                break
            except PortTaken:
                if not left:
                    raise
        yield session, endpoint


@contextmanager
def spoke(
    endpoint: str, extra: str | None = None, patience: float = 0.0, own: str | None = None
) -> Iterator[zenoh.Session]:
    """A session connected to a hub, of the identity `own`. Raises BadInput if there is no hub within `patience`
    [s], and where one of that identity stays.
    """
    config = _config("client", [], [endpoint], extra)
    if own is not None:
        with spoke(endpoint, extra, patience):  # zenoh says the same of no hub and of one that knows the identity
            patience = min(patience, HANDOVER)
        config.insert_json5("id", json.dumps(own))
    config.insert_json5("connect/timeout_ms", json.dumps(round(1000 * patience)))
    try:
        session = _open(config)
    except zenoh.ZError as error:
        problem = f"nothing answers there: {_short(error)}"
        remedy = "start the hub first (nuno serve router), or check --connect"
        if own is not None:
            problem = f"this service of the run is there already (or vanished less than {SILENCE_SECONDS:g} s ago)"
            remedy = "end the other one, or give the run and all its services another name with --run"
        raise BadInput(problem, value=endpoint, remedy=remedy) from None
    with _closing(session):
        yield session


def _open(config: zenoh.Config) -> zenoh.Session:
    """A session; without shared memory where the system has no room for it (/dev/shm), only slower."""
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        if "shm" not in str(error).lower():
            raise
    config.insert_json5("transport/shared_memory/enabled", "false")
    return zenoh.open(config)


@contextmanager
def _closing(session: zenoh.Session) -> Iterator[None]:
    """Close a session at the end; zenoh gives up after 10 s where somebody who is connected does not read."""
    # zenoh's threads outlive their session, and take the interpreter's lock to let go of what they sent. One that meets
    # the interpreter as it shuts down aborts the process: so it has a moment before that. Commands end by `leave`.
    atexit.unregister(_give_way)
    atexit.register(_give_way)
    _open_ones.append(session)
    try:
        yield
    finally:
        _open_ones.remove(session)
        with suppress(zenoh.ZError):
            session.close()


_open_ones: list[zenoh.Session] = []


def _give_way() -> None:
    """Close what a program has left open, as a listener in a variable, and let zenoh's threads end."""
    for session in _open_ones:
        with suppress(zenoh.ZError):
            session.close()
    time.sleep(LINGER)


def direct(take: Callable[[Any], object]) -> zenoh.handlers.Callback[Any]:
    """What is called in zenoh's own thread as something comes, and only puts it away.

    A callback as it is has a thread of Python's, which Python waits for when it ends, for ever where nobody closes.
    """
    return zenoh.handlers.Callback(take, indirect=False)


def cut_off(session: zenoh.Session, endpoint: str) -> str:
    """What is wrong where a spoke has lost the hub at its endpoint; "" where it has not."""
    return "" if session.info.routers_zid() else f"the connection to the hub at {endpoint} broke, or the hub ended"


def _short(error: Exception) -> str:
    return str(error).split(" at /")[0].strip()
