"""A TCP relay that stands for the way between hosts: it delays, limits, and can be cut.

Each piece that comes in is due `delay` seconds later and goes out then, in order, in both directions alike. `rate`
bounds what one direction of one connection carries. While it is cut nothing goes through and nothing is lost, as when a
cable is pulled: TCP keeps what was sent, and whoever waits learns nothing. It runs in a thread of its own.

Network namespaces joined by cables were weighed for the hosts: they take the rights of root, kernels without netem can
neither delay nor drop, and all that a service knows of another host is the relay.
"""

from __future__ import annotations

import asyncio
import contextlib
import threading
import time
from collections.abc import Coroutine, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from typing import Any

PIECE = 2**16
MOST_PIECES = 2**10
"""On their way in one direction: 64 MiB, as a long fast line holds."""
Address = tuple[str, int]


class Relay:
    """Forwards what reaches its own address to `target`; made by `relay`.

    forwarded  bytes, in both directions together
    """

    address: Address

    def __init__(self, target: Address, delay: float, rate: float | None) -> None:
        self.target, self.delay, self.rate, self.forwarded = target, delay, rate, 0
        self.loop = asyncio.new_event_loop()
        self._whole = asyncio.Event()
        self._whole.set()
        self._tasks: set[asyncio.Task[None]] = set()
        self._thread = threading.Thread(target=self.loop.run_forever, daemon=True)
        self._thread.start()

    def listen(self) -> None:
        """Take connections at a free port."""
        starting = asyncio.start_server(self._accept, "127.0.0.1", 0, limit=PIECE)
        server: asyncio.Server = self._call(starting).result(10.0)
        self.address = server.sockets[0].getsockname()[:2]

    def cut(self, seconds: float) -> None:
        """Let nothing through for so long [s]; returns when it is whole again."""
        self.loop.call_soon_threadsafe(self._whole.clear)
        time.sleep(seconds)
        self.loop.call_soon_threadsafe(self._whole.set)

    def close(self) -> None:
        """Break every connection."""
        self._call(self._cancel()).result(10.0)
        self.loop.call_soon_threadsafe(self.loop.stop)
        self._thread.join(10.0)
        self.loop.close()

    def _call(self, work: Coroutine[Any, Any, Any]) -> Future[Any]:
        return asyncio.run_coroutine_threadsafe(work, self.loop)

    async def _cancel(self) -> None:
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    async def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._tasks.add(task)
        with contextlib.suppress(OSError, asyncio.CancelledError), contextlib.closing(writer):
            # Whoever is left sees its connection end.
            await self._whole.wait()
            other_reader, other_writer = await asyncio.open_connection(*self.target, limit=PIECE)
            with contextlib.closing(other_writer):
                await asyncio.gather(self._carry(reader, other_writer), self._carry(other_reader, writer))
        self._tasks.discard(task)

    async def _carry(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """One direction, until its end."""
        line: asyncio.Queue[tuple[float, bytes]] = asyncio.Queue(MOST_PIECES)
        taking = asyncio.create_task(self._take(reader, line))
        free = 0.0
        try:
            while True:
                due, piece = await line.get()
                await asyncio.sleep(max(due, free) - self.loop.time())
                await self._whole.wait()
                if not piece:
                    break
                writer.write(piece)
                await writer.drain()
                self.forwarded += len(piece)
                if self.rate:
                    free = max(free, self.loop.time()) + len(piece) / self.rate
            with contextlib.suppress(OSError, NotImplementedError):
                writer.write_eof()
        finally:
            taking.cancel()

    async def _take(self, reader: asyncio.StreamReader, line: asyncio.Queue[tuple[float, bytes]]) -> None:
        piece = b"-"
        while piece:
            with contextlib.suppress(ConnectionError):
                piece = await reader.read(PIECE)
            await line.put((self.loop.time() + self.delay, piece))


@contextmanager
def relay(target: Address, delay: float = 0.0, rate: float | None = None) -> Iterator[Relay]:
    """A relay that listens on loopback. `delay` is each way [s], `rate` in bytes a second."""
    made = Relay(target, delay, rate)
    try:
        made.listen()
        yield made
    finally:
        made.close()
