"""What listens while a run goes on as a user starts it, and who can reach it from outside."""

from __future__ import annotations

import importlib.util
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import psutil

from nuno.supervision import runs
from nuno.wire.bus import Bus
from nuno.wire.sessions import spoke
from nuno.wire.watch import Watch
from nuno_bench.report.result import Result
from nuno_bench.soak import namespaces, small

START = 300.0
"""Longest that a command may take to be ready [s]: kernels may have to be compiled."""
REACH = "import socket, sys; socket.create_connection((sys.argv[1], int(sys.argv[2])), 2.0)"
Socket = tuple[str, int]


def measure(where: Path, quick: bool) -> list[Result]:
    """Rows for each way in which a run is started; quick: for the plain one."""
    scene = small.write(where, 1.0)
    rows = []
    for case, (words, services, expected) in _cases(where, scene, quick).items():
        with started(words, services) as process:
            found = listening(process.pid)
            rows += _rows(case, found, expected)
            if case == "nuno run":
                rows += reached(found)
    return rows


def _cases(where: Path, scene: Path, quick: bool) -> dict[str, tuple[list[str], set[str], int]]:
    """Command, the services that must be there, and how many sockets may listen."""

    def run(number: int, *more: str) -> list[str]:
        record = str(where / f"open-{number}.mcap")
        return ["run", str(scene), "--paused", "--record", record, "--run", runs.new_id("open"), *more]

    usual = {"simulation", "collision", "recorder"}
    cases = {"nuno run": (run(0, "--no-view"), usual, 1)}
    if quick:
        return cases
    cases["nuno run --processes"] = (run(1, "--no-view", "--processes"), usual, 1)
    if importlib.util.find_spec("rerun"):
        cases["nuno run --view web"] = (run(2, "--view", "web"), {*usual, "viewer"}, 3)
    model = {"plugin": "sheet", "resolution": [7, 7], "cells": "triangles", "fabric": "denim", "pin": ["top-corners"]}
    drawn = small.write(where, 1.0, 7, objects=[{"name": "sheet", "model": model}])
    return cases | {"nuno draw": (["draw", str(drawn), "--no-browser"], set(), 1)}


def _rows(case: str, found: set[Socket], expected: int) -> list[Result]:
    outside = {each for each in found if not each[0].startswith("127.") and each[0] != "::1"}
    note = f"on other addresses: {sorted(outside)}" if outside else ""
    if not found:
        return [Result(case, "sockets that listen", "", failure="none does: the command has ended")]
    return [
        Result(case, "sockets that listen", "", (len(found),), bar=expected, at_most=True),
        Result(case, "of them not on loopback", "", (len(outside),), bar=0, at_most=True, note=note),
    ]


def listening(pid: int) -> set[Socket]:
    """TCP sockets that listen and UDP sockets that are bound, of a process and all that it started.

    Raises psutil.NoSuchProcess where the process itself has ended.
    """
    parent = psutil.Process(pid)
    connections = parent.net_connections(kind="inet")
    for child in parent.children(recursive=True):
        with suppress(psutil.NoSuchProcess):  # as a service may ask the system something
            connections += child.net_connections(kind="inet")
    found = set()
    for each in connections:
        if each.laddr and (each.status == psutil.CONN_LISTEN or each.type == socket.SOCK_DGRAM):
            found.add((str(each.laddr.ip), int(each.laddr.port)))
    return found


@contextmanager
def started(words: list[str], services: set[str]) -> Iterator[subprocess.Popen[str]]:
    """A command of nuno while it goes on, from when its services are there, or it says its first word."""
    process = subprocess.Popen(
        [sys.executable, "-m", "nuno", *words], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    try:
        if services:
            _await_services(process, words[words.index("--run") + 1], services)
        elif process.stdout is not None and not process.stdout.readline():
            raise RuntimeError(f"nuno {words[0]} ended with code {process.wait()}")
        yield process
    finally:
        family = psutil.Process(process.pid).children(recursive=True) if process.poll() is None else []
        process.terminate()
        for each in family:
            if each.is_running():
                each.kill()
        process.wait(30.0)


def _await_services(process: subprocess.Popen[str], run: str, services: set[str]) -> None:
    end = time.monotonic() + START

    def check() -> None:
        if process.poll() is not None or time.monotonic() > end:
            raise RuntimeError(f"the run did not begin: {process.stdout.read() if process.stdout else ''}")

    while run not in runs.running():
        check()
        time.sleep(0.05)
    with spoke(runs.running()[run]) as session:
        watch = Watch(Bus(session, run, "look"))
        while watch.wait_for(services, 0.2):
            check()


def reached(found: set[Socket]) -> list[Result]:
    """Connections to the hub of a plain run from this machine's outer addresses, and from another host."""
    ports = [port for _, port in found]
    outer = [
        each.address
        for cards in psutil.net_if_addrs().values()
        for each in cards
        if each.family == socket.AF_INET and not each.address.startswith("127.")
    ]
    what = "connections made"
    results = []
    if outer:
        made = sum(connects(address, port) for address in outer for port in ports)
        results.append(Result("the hub, by the machine's outer addresses", what, "", (made,), bar=0, at_most=True))
    case = "the hub, from another network namespace"
    try:
        with namespaces.hosts(1) as (host,), socket.create_server((host.ours, 0)) as open_one:
            works = _reaches(host, int(open_one.getsockname()[1]))
            made = sum(_reaches(host, port) for port in ports)
    except PermissionError as error:
        return [*results, Result(case, what, "", (0,), note=f"not tried: {error}")]
    return [
        *results,
        Result("a socket that listens for others, from there", what, "", (works,), bar=1),
        Result(case, what, "", (made,), bar=0, at_most=True),
    ]


def connects(address: str, port: int) -> bool:
    """Whether somebody listens there."""
    try:
        socket.create_connection((address, port), 2.0).close()
    except OSError:
        return False
    return True


def _reaches(host: namespaces.Host, port: int) -> bool:
    """Whether a host gets a connection to a port of ours."""
    command = host.command([sys.executable, "-c", REACH, host.ours, str(port)])
    return subprocess.run(command, capture_output=True, timeout=30.0, check=False).returncode == 0
