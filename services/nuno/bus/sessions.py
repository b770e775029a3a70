"""zenoh sessions that expose nothing: loopback by default, no scouting.

Messages that a run must not lose are sent with blocking congestion control. zenoh blocks for a limited time, then
closes the session that does not read; and such a session delays all others of its hub. So the limit is longer than a
run waits for its services, and the hub blocks only for those: for other sessions it drops messages that they cannot
keep up with.
"""

from __future__ import annotations

import atexit
import contextlib
import hashlib
import json
import re
import socket
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import psutil
import zenoh

from nuno_schemas.errors import BadInput

PATIENCE = 120.0
"""Longest time that a run waits for a required service that neither answers nor ends [s]."""
SILENCE_SECONDS = 1.25 * PATIENCE
"""Time after which a session that is silent, or does not read, is closed [s]: after the warnings of waiting services.

A process that ends closes its connections, which is noticed at once; only a host that vanishes takes this long. With a
shorter time, a service that is stopped for a while, or pages to a slow disk, would count as dead.
"""
QUEUED_BATCHES = 16
"""Most batches of 64 KiB in a session's queue (16 is zenoh's most), by which a slow reader may lag."""

HANDOVER = 3.0
"""Longest time that a session waits for one of its identity to end, once the hub answers [s]."""

LINGER = 0.1
"""Pause at the end of Python for zenoh's threads [s], as explained in `_closing`."""

ATTEMPTS = 20
"""Number of free ports to try: another run may take one before this run listens there."""


class PortTaken(BadInput):
    """Another program listens at the endpoint."""


def free_port() -> int:
    """Return a TCP port on loopback that is free now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def identity(run: str, service: str) -> str:
    """Return the zenoh id of a service's session, by which its hub recognizes it."""
    return "6e" + hashlib.blake2b(f"{run}/{service}".encode(), digest_size=15).hexdigest()


def _qos_rules(trusted: Sequence[str]) -> list[dict[str, Any]]:
    """Return the rules of a hub that blocks for the sessions of `trusted` identities, and drops for all others."""

    def rule(control: str, **selector: Any) -> dict[str, Any]:
        scope = {"messages": ["put"], "key_exprs": ["nuno/**"], "flows": ["egress"]}
        return selector | scope | {"overwrite": {"congestion_control": control}}

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
        # Without scouting, waiting half a second for an answer gains nothing.
        "scouting/delay": 0,
        "transport/link/tx/lease": round(1e3 * SILENCE_SECONDS),
        "transport/link/tx/queue/congestion_control/block/wait_before_close": round(1e6 * SILENCE_SECONDS),
        "transport/link/tx/queue/size/data": QUEUED_BATCHES,
    }
    for endpoint in (*listen, *connect):  # zenoh tries an impossible port for as long as a hub is waited for
        port = re.split("[?#;]", endpoint)[0].rpartition(":")[2]
        if not (endpoint.startswith(("unix", "vsock", "serial")) or (port.isdecimal() and int(port) < 2**16)):
            remedy = "with a port up to 65535, for example tcp/127.0.0.1:7447"
            raise BadInput("not an endpoint", value=endpoint, remedy=remedy)
    for key, value in settings.items():
        try:
            config.insert_json5(key, json.dumps(value))
        except zenoh.ZError:
            raise BadInput("not an endpoint", value=value[0], remedy="for example tcp/127.0.0.1:7447") from None
    return config


@contextmanager
def hub(endpoint: str, extra: str | None = None, trusted: Sequence[str] | None = None) -> Iterator[zenoh.Session]:
    """Open a session that others connect to, e.g. "tcp/127.0.0.1:7447". Raises PortTaken, BadInput.

    `extra` is a zenoh configuration file (TLS, access control) that is read first. `trusted` are the identities of the
    sessions that the hub blocks for; None: it blocks for all.
    """
    config = _config("router", [endpoint], [], extra)
    if trusted is not None:
        config.insert_json5("qos/network", json.dumps(json.loads(config.get_json("qos/network")) + _qos_rules(trusted)))
    try:
        session = _open(config)
    except zenoh.ZError as error:
        if "in use" in str(error):
            remedy = "choose another port: --listen tcp/127.0.0.1:PORT"
            raise PortTaken("another program listens there", value=endpoint, remedy=remedy) from None
        remedy = "check the endpoint"
        raise BadInput(f"cannot listen: {_short(error)}", value=endpoint, remedy=remedy) from None
    if not re.match(r"(tls|quic|unixsock\S*)/|\w+/(127\.[\d.]+|localhost|\[::1\]):", endpoint):
        text = f"whoever reaches {endpoint} may control the run: nuno certs makes certificates, for tls/ endpoints"
        print(text, file=sys.stderr, flush=True)
    with _closing(session):
        yield session


@contextmanager
def hub_at(
    listen: str | None, extra: str | None = None, trusted: Sequence[str] | None = None
) -> Iterator[tuple[zenoh.Session, str]]:
    """Open a hub at `listen`, by default at a free port of loopback; yield it and its endpoint. Raises as `hub`."""
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
    """Open a session connected to a hub, with the identity `own`. Raises BadInput if there is no hub within `patience`
    [s], or another session of that identity stays.
    """
    config = _config("client", [], [endpoint], extra)
    if own is not None:
        with spoke(endpoint, extra, patience):  # zenoh raises the same without a hub and for a known identity
            patience = min(patience, HANDOVER)
        config.insert_json5("id", json.dumps(own))
    config.insert_json5("connect/timeout_ms", json.dumps(round(1000 * patience)))
    try:
        session = _open(config)
    except zenoh.ZError as error:
        problem = f"nothing answers there: {_short(error)}"
        remedy = "start the hub first (nuno serve router), or check --connect"
        if _accepts(endpoint):
            problem = "something listens there, and no session comes about"
            remedy = "check tls/ or tcp/, that its certificate names this host, and --config: authority or password"
        if own is not None:
            problem = f"this service of the run is there already (or vanished less than {SILENCE_SECONDS:g} s ago)"
            remedy = "end the other one, or give the run and all its services another name with --run"
        raise BadInput(problem, value=endpoint, remedy=remedy) from None
    with _closing(session):
        yield session


def _accepts(endpoint: str) -> bool:
    """Return whether a program listens at a TCP endpoint, be it no hub."""
    host, _, port = endpoint.partition("/")[2].rpartition(":")
    with suppress(OSError, ValueError), socket.create_connection((host.strip("[]"), int(port)), 2.0):
        return True
    return False


def _open(config: zenoh.Config) -> zenoh.Session:
    """Open a session; without shared memory, and slower, where the system has no room for it (/dev/shm)."""
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        if "shm" not in str(error).lower():
            raise
    config.insert_json5("transport/shared_memory/enabled", "false")
    return zenoh.open(config)


@contextmanager
def _closing(session: zenoh.Session) -> Iterator[None]:
    """Close a session at the end; zenoh gives up after 10 s if a connected session does not read."""
    # zenoh's threads outlive their session, and take the interpreter's lock to free their messages. A thread that does
    # so while the interpreter shuts down aborts the process: hence the pause before that. Commands end by `leave`.
    atexit.unregister(_close_all)
    atexit.register(_close_all)
    _open_sessions.append(session)
    try:
        yield
    finally:
        _open_sessions.remove(session)
        with suppress(zenoh.ZError):
            session.close()


_open_sessions: list[zenoh.Session] = []


def _close_all() -> None:
    """Close sessions that a program has left open, as a listener in a variable, and let zenoh's threads end."""
    for session in _open_sessions:
        with suppress(zenoh.ZError):
            session.close()
    time.sleep(LINGER)


def direct(take: Callable[[Any], object]) -> zenoh.handlers.Callback[Any]:
    """Return a callback that zenoh calls in its own thread; it may only enqueue.

    A plain callback gets a Python thread, and Python waits for that at its end, forever if nobody closes the session.
    """
    return zenoh.handlers.Callback(take, indirect=False)


def cut_off(session: zenoh.Session, endpoint: str) -> str:
    """Return the problem of a spoke that has lost the hub at its endpoint; "" if it has not."""
    return "" if session.info.routers_zid() else f"the connection to the hub at {endpoint} broke, or the hub ended"


def _short(error: Exception) -> str:
    return str(error).split(" at /")[0].strip()


# Detection of subscribers that do not read, by the system's table of connections, since zenoh does not report them.
#
# A subscriber that is stopped, or whose callback never returns, leaves bytes in its connection: unread in its own
# queue, and then unsent in the hub's. They only grow; those of a subscriber that reads rise and fall.

TABLES = (Path("/proc/net/tcp"), Path("/proc/net/tcp6"))
LOOK_SECONDS = 1.0
BEHIND_SECONDS = 5.0
"""A session is slow if its waiting bytes have not decreased for this time [s]."""

Ports = tuple[int, int]
"""Ports of a connection: the hub's, and the other end's."""


def queues() -> dict[Ports, tuple[int, int]]:
    """Return the unsent and unread bytes of each TCP connection of this host; empty on systems other than Linux.

    A line holds `index: address:port address:port state unsent:unread ...`, all in hexadecimal (proc(5)).
    """
    waiting: dict[Ports, tuple[int, int]] = {}
    for table in TABLES:
        with contextlib.suppress(OSError):
            for line in table.read_text().splitlines()[1:]:
                fields = line.split()
                here, there = (int(address.rpartition(":")[2], 16) for address in fields[1:3])
                unsent, _, unread = fields[4].partition(":")
                waiting[here, there] = int(unsent, 16), int(unread, 16)
    return waiting


class SlowConsumers:
    """Watches the sessions of a hub except other routers; `names` are those of known services, by identity."""

    def __init__(self, hub: zenoh.Session, names: Mapping[str, str]) -> None:
        self._hub, self._names = hub, names
        self._checked_at = 0.0
        self._since: dict[Ports, tuple[float, int]] = {}
        """Time since which bytes wait [s], and their number."""
        self._warned: set[Ports] = set()

    def look(self, say: Callable[[str], None]) -> None:
        """Pass a warning of each new slow session to `say`, once; check at most every LOOK_SECONDS."""
        now = time.monotonic()
        if now - self._checked_at < LOOK_SECONDS:
            return
        self._checked_at = now
        routers = {str(router) for router in self._hub.info.routers_zid()}
        readers = [link for link in self._hub.info.links() if str(link.zid) not in routers]
        links = {(_port(link.src), _port(link.dst)): link for link in readers}
        waiting = queues() if links else {}
        for (here, there), link in links.items():
            unsent, unread = waiting.get((here, there), (0, 0))[0], waiting.get((there, here), (0, 0))[1]
            since, earlier = self._since.get((here, there), (now, 0))
            since = since if 0 < earlier <= unsent + unread else now
            self._since[here, there] = since, unsent + unread
            if now - since >= BEHIND_SECONDS and (here, there) not in self._warned:
                self._warned.add((here, there))
                say(self._describe(str(link.zid), str(link.dst), there))
        self._since = {ports: entry for ports, entry in self._since.items() if ports in links}
        self._warned &= links.keys()

    def _describe(self, identity: str, address: str, port: int) -> str:
        if identity in self._names:
            return f"the {self._names[identity]} service has read nothing for {BEHIND_SECONDS:g} s"
        reader = f"{_program(port) or 'a program'} at {address.partition('/')[2]}"
        loss = "misses messages" if self._names else "holds up all that this router passes on"
        return f"a subscriber reads nothing and {loss}: {reader}"


def _port(address: str) -> int:
    """Return the port of an endpoint such as tcp/127.0.0.1:7447; 0 where it has none."""
    port = address.partition("?")[0].rpartition(":")[2]
    return int(port) if port.isdigit() else 0


def _program(port: int) -> str:
    """Return the process of this host that holds a port, "" if the user may not see it."""
    with contextlib.suppress(psutil.Error, OSError):
        for connection in psutil.net_connections("tcp"):
            if connection.laddr and connection.laddr.port == port and connection.pid:
                return f"{psutil.Process(connection.pid).name()}, process {connection.pid},"
    return ""
