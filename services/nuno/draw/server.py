"""The page's server: files of the page, the cloth as it moves, and what the page asks to be done."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Mapping
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from socket import socket
from typing import Any
from urllib.parse import parse_qs, urlsplit

from nuno.draw.guard import HEADERS, Guard, Refused
from nuno.draw.refusals import describe
from nuno.draw.sight import Board
from nuno_schemas.errors import BadInput

KINDS = {"html": "text/html", "css": "text/css", "js": "text/javascript", "svg": "image/svg+xml"}
MOST_CONNECTIONS = 32
IDLE = 30.0
"""Silence after which a connection ends [s]: longer than a page waits for a frame."""
PATIENCE = 10.0
"""How long a question for the next frame waits for one [s]."""
NOT_FOUND, BAD_REQUEST, BUSY = 404, 400, 503

Act = Callable[[Mapping[str, Any]], dict[str, Any]]


def page_files() -> dict[str, tuple[str, bytes]]:
    """Name -> content type and bytes of all that the page consists of."""
    found = {}
    for path in (files("nuno.draw") / "page").iterdir():
        kind = KINDS.get(path.name.rpartition(".")[2])
        if kind is not None:
            found[path.name] = (f"{kind}; charset=utf-8", path.read_bytes())
    return found


class Server(ThreadingHTTPServer):
    """Serves one page on a free port of loopback; a thread for each connection, of which there are few.

    `act` carries out what the page asks for; what it raises as BadInput, the page shows.
    """

    daemon_threads = True

    def __init__(self, board: Board, act: Act) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.guard = Guard(int(self.server_address[1]))
        self.board, self.act, self.files = board, act, page_files()
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
        if name == "frame":
            after, shape, place = (_whole(query, key) for key in ("after", "shape", "place"))
            return "application/octet-stream", self.server.board.wait(after, PATIENCE).encode(shape, place)
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


def _whole(query: Mapping[str, list[str]], key: str) -> int:
    text = query.get(key, ["-1"])[0]
    if not text.lstrip("-").isdecimal() or len(text) > 12:
        raise Refused(BAD_REQUEST, f"{key} is a whole number")
    return int(text)
