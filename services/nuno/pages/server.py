"""A page's server: files of the page, what it is told of by its own addresses, and what it asks to be done."""

from __future__ import annotations

import json
import threading
import webbrowser
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from socket import socket
from typing import Any
from urllib.parse import parse_qs, urlsplit

from nuno.pages.guard import HEADERS, Guard, Refused
from nuno.viewer.require import has_screen
from nuno_schemas.errors import BadInput

KINDS = {"html": "text/html", "css": "text/css", "js": "text/javascript", "svg": "image/svg+xml"}
MOST_CONNECTIONS = 32
IDLE = 30.0
"""Silence after which a connection ends [s]: longer than a page waits for what it is told of."""
SHARED = files("nuno.pages") / "shared"
NOT_FOUND, BAD_REQUEST, BUSY = 404, 400, 503

Act = Callable[[Mapping[str, Any]], dict[str, Any]]
Tell = Callable[[Mapping[str, list[str]]], tuple[str, bytes]]
"""From the query of an address to content type and bytes. Raises Refused."""


def page_files(package: str) -> dict[str, tuple[str, bytes]]:
    """Name -> content type and bytes of all that a package's page consists of, and of what all pages share."""
    found = {}
    for folder in (SHARED, files(package) / "page"):
        for path in folder.iterdir():
            kind = KINDS.get(path.name.rpartition(".")[2])
            if kind is not None:
                found[path.name] = (f"{kind}; charset=utf-8", path.read_bytes())
    return found


def describe(error: BadInput) -> dict[str, Any]:
    """What a page is told of an error; `words` is what the command line prints."""
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
    """Serves one page, that of a package, on a free port of loopback; a thread for each connection, of which there
    are few.

    `act` carries out what the page asks for; what it raises as BadInput, the page shows. `told` answers what is read
    at addresses beside the page's files.
    """

    daemon_threads = True

    def __init__(self, package: str, act: Act, told: Mapping[str, Tell]) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.guard = Guard(int(self.server_address[1]))
        self.act, self.told, self.files = act, told, page_files(package)
        self._places = threading.BoundedSemaphore(MOST_CONNECTIONS)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Take a connection where there is room for one."""
        if self._places.acquire(blocking=False):
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._places.release()

    def handle_error(self, request: socket | tuple[bytes, socket], client_address: Any) -> None:
        """A connection that breaks is the browser's business."""


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
            kind, body = self._post(name) if method == "POST" else self._get(name, parse_qs(parts.query))
            self._send(200, kind, body)
        except Refused as refused:
            self.close_connection = True  # what is left of the request is not read
            self._send(refused.status, "text/plain; charset=utf-8", f"{refused.status}: {refused.why}\n".encode())

    def _get(self, name: str, query: Mapping[str, list[str]]) -> tuple[str, bytes]:
        if name in self.server.told:
            return self.server.told[name](query)
        try:
            return self.server.files[name or "index.html"]
        except KeyError:
            raise Refused(NOT_FOUND, "there is no such page") from None

    def _post(self, name: str) -> tuple[str, bytes]:
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
        try:
            answer = {"ok": True} | self.server.act(request)
        except BadInput as error:
            answer = {"ok": False} | describe(error)
        return "application/json", json.dumps(answer).encode()

    def _send(self, status: int, kind: str, body: bytes) -> None:
        self.send_response(status)
        for key, value in HEADERS.items():
            self.send_header(key, value)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: Any) -> None:
        """Nothing: the address, which is a secret, would stand in the log."""


def whole(query: Mapping[str, list[str]], key: str) -> int:
    """A whole number of a query, -1 where it is not given. Raises Refused."""
    text = query.get(key, ["-1"])[0]
    if not text.lstrip("-").isdecimal() or len(text) > 12:
        raise Refused(BAD_REQUEST, f"{key} is a whole number")
    return int(text)


@contextmanager
def serving(server: Server, name: str, opened: bool, place: str = "") -> Iterator[None]:
    """Serve a page until the block ends; its address, of a place of it, is printed and, where there is a screen and it
    is `opened`, shown in a browser.
    """
    address = server.guard.address + place
    print(f"{name} at  {address}", flush=True)
    print("the address is for this machine, and for you alone; Ctrl-C ends", flush=True)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    if opened and has_screen():
        webbrowser.open(address)
    try:
        yield
    finally:
        server.shutdown()
        server.server_close()
