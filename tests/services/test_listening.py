"""Only what must listen does while a run goes on as a user starts it, and only on loopback."""

from __future__ import annotations

import importlib.util
import socket
from contextlib import suppress
from pathlib import Path

import psutil
import pytest

from nuno.bus.sessions import free_port, hub
from soak import scenes
from soak.processes import Processes

DRAWN = {"plugin": "sheet", "resolution": [7, 7], "cells": "triangles", "fabric": "denim", "pin": ["top-corners"]}


def listening(pid: int) -> set[tuple[str, int]]:
    """TCP sockets that listen and UDP sockets that are bound, of a process and all that it started."""
    found = set()
    parent = psutil.Process(pid)
    for process in (parent, *parent.children(recursive=True)):
        with suppress(psutil.NoSuchProcess):  # as a service may ask the system something
            for each in process.net_connections(kind="inet"):
                if each.laddr and (each.status == psutil.CONN_LISTEN or each.type == socket.SOCK_DGRAM):
                    found.add((str(each.laddr.ip), int(each.laddr.port)))
    return found


def connects(address: str, port: int) -> bool:
    try:
        socket.create_connection((address, port), 2.0).close()
    except OSError:
        return False
    return True


@pytest.mark.parametrize(
    ("words", "most"), [(("--no-view",), 1), pytest.param(("--processes", "--view", "web"), 3, marks=pytest.mark.full)]
)
def test_of_a_run_only_the_hub_and_a_viewer_listen(words: tuple[str, ...], most: int, tmp_path: Path) -> None:
    if "web" in words and importlib.util.find_spec("rerun") is None:
        pytest.skip("no rerun viewer is installed")
    with Processes(tmp_path) as live:
        live.supervise(scenes.sheet(tmp_path, 1.0), "--paused", *words)
        assert live.wait_for("paused"), live.said()
        found = listening(live.children["supervisor"].pid)
    assert 0 < len(found) <= most
    assert all(address.startswith("127.") for address, _ in found)


def test_of_the_page_for_drawing_one_socket_listens(tmp_path: Path) -> None:
    with Processes(tmp_path) as live:
        scene = scenes.sheet(tmp_path, 1.0, 7, objects=[{"name": "sheet", "model": DRAWN}])
        live.start("draw", "draw", scene, "--no-browser")
        assert live.wait_for("", "draw"), live.said()
        ((address, _),) = listening(live.children["draw"].pid)
    assert address.startswith("127.")


def test_the_hub_is_not_reached_by_the_machines_outer_addresses(tmp_path: Path) -> None:
    cards = [each for card in psutil.net_if_addrs().values() for each in card if each.family == socket.AF_INET]
    outer = [each.address for each in cards if not each.address.startswith("127.")]
    with Processes(tmp_path) as live, socket.create_server(("0.0.0.0", 0)) as everywhere:
        live.supervise(scenes.sheet(tmp_path, 1.0), "--paused", "--no-view")
        assert live.wait_for("paused"), live.said()
        ((_, port),) = listening(live.children["supervisor"].pid)
        assert connects("127.0.0.1", port)
        for address in outer:
            assert connects(address, everywhere.getsockname()[1]), "one that listens for all is reached"
            assert not connects(address, port)


def test_a_hub_that_others_reach_without_a_certificate_is_warned_of(capsys: pytest.CaptureFixture[str]) -> None:
    for host in ("0.0.0.0", "127.0.0.1", "localhost"):
        with hub(f"tcp/{host}:{free_port()}"):
            assert ("nuno certs makes certificates" in capsys.readouterr().err) == (host == "0.0.0.0")
