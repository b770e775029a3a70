"""Network namespaces as hosts: each joined by a cable of its own (a veth pair) to the namespace that we are in.

    host 0: 10.A.0.2 ---- 10.A.0.1 | here
    host 1: 10.A.1.2 ---- 10.A.1.1 |

Nothing is forwarded between the cables, so hosts reach each other only through what listens here. It takes the rights
of root; A follows from the process's number, so that several do not meet.
"""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from itertools import count

_NUMBERS = count()


@dataclass(frozen=True)
class Host:
    """One namespace: how it is called, its address, and ours on the same cable."""

    name: str
    address: str
    ours: str

    def command(self, words: list[str]) -> list[str]:
        """The command that runs `words` there."""
        return ["ip", "netns", "exec", self.name, *words] if self.name else words


def local_hosts(number: int) -> list[Host]:
    """As many that are all this machine, where namespaces are not permitted."""
    return [Host("", "127.0.0.1", "127.0.0.1") for _ in range(number)]


@contextmanager
def hosts(number: int) -> Iterator[list[Host]]:
    """As many namespaces. Raises PermissionError where they are not permitted."""
    with ExitStack() as stack:
        yield [stack.enter_context(_host(k)) for k in range(number)]


@contextmanager
def _host(k: int) -> Iterator[Host]:
    mark, net = f"{os.getpid()}-{next(_NUMBERS)}", f"10.{64 + os.getpid() % 128}.{k}"
    name, cable = f"nuno-{mark}", f"n{mark}"[:15]
    _ip("netns", "add", name)
    try:
        _ip("link", "add", cable, "type", "veth", "peer", "name", "eth0", "netns", name)
        _ip("addr", "add", f"{net}.1/30", "dev", cable)
        _ip("link", "set", cable, "up")
        _ip("-n", name, "addr", "add", f"{net}.2/30", "dev", "eth0")
        _ip("-n", name, "link", "set", "eth0", "up")
        _ip("-n", name, "link", "set", "lo", "up")
        yield Host(name, f"{net}.2", f"{net}.1")
    finally:
        subprocess.run(["ip", "link", "del", cable], capture_output=True, check=False)
        subprocess.run(["ip", "netns", "del", name], capture_output=True, check=False)


def _ip(*words: str) -> None:
    try:
        done = subprocess.run(["ip", *words], capture_output=True, text=True, timeout=20.0, check=False)
    except FileNotFoundError:
        raise PermissionError("there is no command ip on this machine") from None
    if done.returncode:
        raise PermissionError(f"network namespaces are not permitted here: {done.stderr.strip()}")
