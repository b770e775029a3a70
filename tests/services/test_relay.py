"""The relay that stands for the way between hosts: what it carries, how late, and what a cut does."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator

import numpy as np
import pytest
from relay import relay


@pytest.fixture
def echo() -> Iterator[tuple[str, int]]:
    """A server that sends back what it gets."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            connection, _ = server.accept()
            with connection:
                while piece := connection.recv(2**16):
                    connection.sendall(piece)
                connection.shutdown(socket.SHUT_WR)

        threading.Thread(target=serve, daemon=True).start()
        yield server.getsockname()[:2]


def there_and_back(address: tuple[str, int], data: bytes) -> bytes:
    with socket.create_connection(address, 20.0) as client:
        threading.Thread(target=lambda: (client.sendall(data), client.shutdown(socket.SHUT_WR)), daemon=True).start()
        found = b"".join(iter(lambda: client.recv(2**16), b""))
    return found


def test_bytes_come_through_in_order_and_as_late_as_it_says(echo: tuple[str, int]) -> None:
    data = np.random.default_rng(0).bytes(2_000_000)
    with relay(echo, delay=0.05) as line:
        begin = time.monotonic()
        assert there_and_back(line.address, data) == data
        assert time.monotonic() - begin >= 0.1, "each way takes 50 ms"
        assert line.forwarded == 2 * len(data)


def test_no_more_than_its_rate_comes_through(echo: tuple[str, int]) -> None:
    data = bytes(400_000)
    with relay(echo, rate=2e6) as line:
        begin = time.monotonic()
        assert there_and_back(line.address, data) == data
        assert time.monotonic() - begin >= (400_000 - 2**16) / 2e6


def test_a_cut_holds_everything_back_and_loses_nothing(echo: tuple[str, int]) -> None:
    with relay(echo) as line, socket.create_connection(line.address, 20.0) as client:
        client.sendall(b"before")
        assert client.recv(100) == b"before"
        cut = threading.Thread(target=line.cut, args=(0.4,))
        begin = time.monotonic()
        cut.start()
        time.sleep(0.05)
        client.sendall(b"meanwhile")
        assert client.recv(100) == b"meanwhile"
        assert time.monotonic() - begin >= 0.4
        cut.join()
