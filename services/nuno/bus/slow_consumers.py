"""Who does not read what a hub sends: seen in the system's table of connections, since zenoh does not tell.

A subscriber that is stopped, or whose callback never returns, leaves bytes in its connection: unread in its own
queue, and then unsent in the hub's. They only ever grow; those of one that reads go up and down.
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
"""Where bytes have waited this long, and were fewer at no look, nobody reads them."""

Ports = tuple[int, int]
"""Of a connection: its own, and the other end's."""


def queues(tables: tuple[Path, ...] = TABLES) -> dict[Ports, tuple[int, int]]:
    """Bytes unsent and unread of each TCP connection of this host; empty where the system does not tell (Linux does).

    A line holds `index: address:port address:port state unsent:unread ...`, all in hexadecimal (proc(5)).
    """
    found: dict[Ports, tuple[int, int]] = {}
    for table in tables:
        with contextlib.suppress(OSError):
            for line in table.read_text().splitlines()[1:]:
                fields = line.split()
                own, other = (int(address.rpartition(":")[2], 16) for address in fields[1:3])
                unsent, _, unread = fields[4].partition(":")
                found[own, other] = int(unsent, 16), int(unread, 16)
    return found


class SlowConsumers:
    """Watches the sessions of a hub, other routers' left out; `names` are those of known ones, by identity."""

    def __init__(self, hub: zenoh.Session, names: Mapping[str, str]) -> None:
        self._hub, self._names = hub, names
        self._looked = 0.0
        self._since: dict[Ports, tuple[float, int]] = {}
        """Since when bytes have been waiting, and how many do."""
        self._told: set[Ports] = set()

    def look(self, say: Callable[[str], None]) -> None:
        """Name who has fallen behind since the last look, each once; looks no more often than LOOK_SECONDS."""
        now = time.monotonic()
        if now - self._looked < LOOK_SECONDS:
            return
        self._looked = now
        routers = {str(router) for router in self._hub.info.routers_zid()}
        readers = [link for link in self._hub.info.links() if str(link.zid) not in routers]
        links = {(_port(link.src), _port(link.dst)): link for link in readers}
        waiting = queues() if links else {}
        for (own, other), link in links.items():
            unsent, unread = waiting.get((own, other), (0, 0))[0], waiting.get((other, own), (0, 0))[1]
            since, before = self._since.get((own, other), (now, 0))
            since = since if 0 < before <= unsent + unread else now
            self._since[own, other] = since, unsent + unread
            if now - since >= BEHIND_SECONDS and (own, other) not in self._told:
                self._told.add((own, other))
                say(self._describe(str(link.zid), str(link.dst), other))
        self._since = {ports: kept for ports, kept in self._since.items() if ports in links}
        self._told &= links.keys()

    def _describe(self, identity: str, address: str, port: int) -> str:
        if identity in self._names:
            return f"the {self._names[identity]} service has read nothing for {BEHIND_SECONDS:g} s"
        whose = f"{_program(port) or 'a program'} at {address.partition('/')[2]}"
        loss = "misses messages" if self._names else "holds up all that this router passes on"
        return f"a subscriber reads nothing and {loss}: {whose}"


def _port(address: str) -> int:
    """Of an endpoint such as tcp/127.0.0.1:7447; 0 where it has none."""
    port = address.partition("?")[0].rpartition(":")[2]
    return int(port) if port.isdigit() else 0


def _program(port: int) -> str:
    """Which of this host's processes holds a port, as far as the user may know."""
    with contextlib.suppress(psutil.Error, OSError):
        for connection in psutil.net_connections("tcp"):
            if connection.laddr and connection.laddr.port == port and connection.pid:
                return f"{psutil.Process(connection.pid).name()}, process {connection.pid},"
    return ""
