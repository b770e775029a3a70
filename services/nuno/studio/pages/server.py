"""A page's server: files of the page, resources at its own addresses, and requests."""

from __future__ import annotations

import contextlib
import json
import logging
import re
import threading
import webbrowser
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from io import BufferedIOBase
from socket import SHUT_RDWR, socket
from typing import Any, NamedTuple
from urllib.parse import parse_qs, urlsplit

from nuno.process import scratch
from nuno.studio.pages.guard import FILE, HEADERS, Guard, Refused
from nuno.viewer.live import has_screen
from nuno_schemas.errors import BadInput

LOGGER = logging.getLogger("nuno.studio.pages")
KINDS = {"html": "text/html", "css": "text/css", "js": "text/javascript", "svg": "image/svg+xml"}
MOST_CONNECTIONS = 32
LEAVING = 1.0
"""Longest time for closing a connection to make room for another [s]."""
IDLE = 30.0
"""Silence after which a connection ends [s]: longer than a page's longest wait for a resource."""
SHARED = files("nuno.studio.pages") / "shared"
NOT_FOUND, BAD_REQUEST, FAULT = 404, 400, 500

Act = Callable[[Mapping[str, Any]], dict[str, Any]]
Resource = Callable[[Mapping[str, list[str]]], tuple[str, bytes]]
"""Returns content type and bytes for the query of an address. Raises Refused."""


class Take(NamedTuple):
    """Handler of uploaded files: `keep` reads a file of a name and length from a stream; `most` limits the length."""

    keep: Callable[[str, BufferedIOBase, int], dict[str, Any]]
    most: int


def page_files(package: str) -> dict[str, tuple[str, bytes]]:
    """Return content type and bytes, by name, of the files of a package's page and of all pages' shared files."""
    contents = {}
    for folder in (SHARED, files(package) / "page"):
        for path in folder.iterdir():
            kind = KINDS.get(path.name.rpartition(".")[2])
            if kind is not None:
                contents[path.name] = (f"{kind}; charset=utf-8", path.read_bytes())
    return contents


def describe(error: BadInput) -> dict[str, Any]:
    """Return an error as JSON for a page; `words` is the text of the command line."""
    value = None if error.value is None else str(error.value)[:200]
    return {
        "problem": error.problem,
        "field": error.field or "",
        "line": error.line,
        "value": value,
        "limit": error.limit,
        "remedy": error.remedy,
        "words": str(error),
    }


class Server(ThreadingHTTPServer):
    """Serves the page of a package on a free port of loopback, with a thread for each of a few connections.

    `act` carries out the page's requests; the page shows its BadInput. `resources` answer addresses other than the
    page's files. `take` receives files that are dropped on the page.
    """

    daemon_threads = True
    request_queue_size = 4 * MOST_CONNECTIONS

    def __init__(self, package: str, act: Act, resources: Mapping[str, Resource], take: Take | None = None) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.guard = Guard(int(self.server_address[1]))
        self.act, self.resources, self.take, self.files = act, resources, take, page_files(package)
        self._places = threading.BoundedSemaphore(MOST_CONNECTIONS)
        self.silent: dict[socket, None] = {}
        """Connections without a permitted request in progress, the oldest first."""

    def process_request(self, request: Any, client_address: Any) -> None:
        """Accept a connection; if there are too many, close the one that has been silent for longest: another user's
        program could otherwise hold all of them.
        """
        accepted = self._places.acquire(blocking=False)
        if not accepted:
            with contextlib.suppress(StopIteration, RuntimeError, OSError):
                next(iter(self.silent)).shutdown(SHUT_RDWR)
            accepted = self._places.acquire(timeout=LEAVING)
        if accepted:
            self.silent[request] = None
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        try:
            super().process_request_thread(request, client_address)
        finally:
            self.silent.pop(request, None)
            self._places.release()

    def handle_error(self, request: socket | tuple[bytes, socket], client_address: Any) -> None:
        """Ignore broken connections, which the browser handles."""


class Handler(BaseHTTPRequestHandler):
    """One connection."""

    server: Server
    protocol_version = "HTTP/1.1"
    timeout = IDLE
    server_version, sys_version = "nuno", ""

    def do_GET(self) -> None:
        self._answer("GET")

    def do_POST(self) -> None:
        self._answer("POST")

    def _answer(self, method: str) -> None:
        try:
            parts = urlsplit(self.path)
            name = self.server.guard.check(method, parts.path, self.headers)
            self.server.silent.pop(self.connection, None)
            query = parse_qs(parts.query)
            kind, body = self._post(name, query) if method == "POST" else self._get(name, query)
            self._send(200, kind, body)
        except Refused as refused:
            self.close_connection = True  # the rest of the request is not read
            self._send(refused.status, "text/plain; charset=utf-8", f"{refused.status}: {refused.why}\n".encode())
        except OSError:  # the browser has gone
            raise
        except Exception:
            # Without the address, which is a secret.
            LOGGER.exception("a request of the page failed: this is a fault of nuno's")
            self.close_connection = True
            self._send(FAULT, "text/plain; charset=utf-8", b"500: nuno failed; its terminal says where\n")

    def _get(self, name: str, query: Mapping[str, list[str]]) -> tuple[str, bytes]:
        if name in self.server.resources:
            return self.server.resources[name](query)
        try:
            return self.server.files[name or "index.html"]
        except KeyError:
            raise Refused(NOT_FOUND, "there is no such page") from None

    def _post(self, name: str, query: Mapping[str, list[str]]) -> tuple[str, bytes]:
        take = self.server.take
        if name == "file" and take is not None:
            length = self.server.guard.length(self.headers, take.most, FILE)
            keep = partial(take.keep, query.get("name", [""])[0], self.rfile, length)
            return self._carry_out(keep, read=False)
        length = self.server.guard.length(self.headers)
        body = self.rfile.read(length)
        if name != "do":
            raise Refused(NOT_FOUND, "there is no such page")
        try:
            request = json.loads(body)
        except (ValueError, RecursionError):
            request = None
        if not isinstance(request, dict):
            raise Refused(BAD_REQUEST, "a request is a JSON object")
        return self._carry_out(partial(self.server.act, request))

    def _carry_out(self, act: Callable[[], dict[str, Any]], read: bool = True) -> tuple[str, bytes]:
        """Return the answer of `act`, or its error; `read` tells whether all of the request has been read."""
        try:
            answer = {"ok": True} | act()
        except BadInput as error:
            answer = {"ok": False} | describe(error)
            self.close_connection |= not read
        return "application/json", json.dumps(answer).encode()

    def _send(self, status: int, kind: str, body: bytes) -> None:
        self.send_response(status)
        for key, value in HEADERS.items():
            self.send_header(key, value)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        if self.close_connection:
            self.send_header("Connection", "close")
        self.end_headers()
        self.wfile.write(body)
        self.server.silent[self.connection] = None

    def log_message(self, format: str, *args: Any) -> None:
        """Log nothing, since the address is a secret."""


def whole(query: Mapping[str, list[str]], key: str) -> int:
    """Return an integer of a query, -1 if it is missing. Raises Refused."""
    text = query.get(key, ["-1"])[0]
    if not re.fullmatch(r"-?[0-9]{1,12}", text):
        raise Refused(BAD_REQUEST, f"{key} is a whole number")
    return int(text)


@contextmanager
def serving(server: Server, name: str, opened: bool, place: str = "") -> Iterator[None]:
    """Serve a page until the block ends; print the address of a `place` in it and, if `opened` and there is a screen,
    show it in a browser.
    """
    address = server.guard.address + place
    print(f"{name} at  {address}", flush=True)
    print("the address is for this machine, and for you alone; Ctrl-C ends", flush=True)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        with door(address) as uri:
            if opened and has_screen():
                webbrowser.open(uri)
            yield
    finally:
        server.shutdown()
        server.server_close()


@contextmanager
def door(address: str) -> Iterator[str]:
    """Yield the URI of a file, readable by this user alone, that redirects a browser to an address.

    All users of a machine can read the arguments of processes, such as a browser's, and the address is a secret.
    """
    with scratch() as folder:
        path = folder / "open.html"
        path.touch(mode=0o600)
        path.write_text(f'<!doctype html><title>nuno</title><meta http-equiv="refresh" content="0; url={address}">')
        yield path.as_uri()
