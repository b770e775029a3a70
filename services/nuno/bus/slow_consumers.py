"""Detection of subscribers that do not read, by the system's table of connections, since zenoh does not report them.

A subscriber that is stopped, or whose callback never returns, leaves bytes in its connection: unread in its own
queue, and then unsent in the hub's. They only grow; those of a subscriber that reads rise and fall.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Mapping
from pathlib import Path

import psutil
import zenoh

TABLES = (Path("/proc/net/tcp"), Path("/proc/net/tcp6"))
LOOK_SECONDS = 1.0
BEHIND_SECONDS = 5.0
"""A session is slow if its waiting bytes have not decreased for this time [s]."""

Ports = tuple[int, int]
"""Ports of a connection: the hub's, and the other end's."""


def queues(tables: tuple[Path, ...] = TABLES) -> dict[Ports, tuple[int, int]]:
    """Return the unsent and unread bytes of each TCP connection of this host; empty on systems other than Linux.

    A line holds `index: address:port address:port state unsent:unread ...`, all in hexadecimal (proc(5)).
    """
    waiting: dict[Ports, tuple[int, int]] = {}
    for table in tables:
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
