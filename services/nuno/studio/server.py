"""The page's server: files of the page, resources at its own addresses, requests, and who may send them."""

from __future__ import annotations

import contextlib
import json
import logging
import re
import secrets
import threading
import webbrowser
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from email.message import Message
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from io import BufferedIOBase
from socket import SHUT_RDWR, socket
from typing import Any, NamedTuple
from urllib.parse import parse_qs, urlsplit

from nuno.process import scratch
from nuno.viewer.live import has_screen
from nuno_schemas.errors import BadInput

LOGGER = logging.getLogger("nuno.studio")
KINDS = {"html": "text/html", "css": "text/css", "js": "text/javascript", "svg": "image/svg+xml"}
MOST_CONNECTIONS = 32
LEAVING = 1.0
"""Longest time for closing a connection to make room for another [s]."""
IDLE = 30.0
"""Silence after which a connection ends [s]: longer than a page's longest wait for a resource."""
NOT_FOUND, BAD_REQUEST, FAULT = 404, 400, 500

Act = Callable[[Mapping[str, Any]], dict[str, Any]]
Resource = Callable[[Mapping[str, list[str]]], tuple[str, bytes]]
"""Returns content type and bytes for the query of an address. Raises Refused."""


class Take(NamedTuple):
    """Handler of uploaded files: `keep` reads a file of a name and length from a stream; `most` limits the length."""

    keep: Callable[[str, BufferedIOBase, int], dict[str, Any]]
    most: int


def page_files() -> dict[str, tuple[str, bytes]]:
    """Return content type and bytes, by name, of the files of the page."""
    contents = {}
    for path in (files("nuno.studio") / "page").iterdir():
        kind = KINDS.get(path.name.rpartition(".")[2])
        if kind is not None:
            contents[path.name] = (f"{kind}; charset=utf-8", path.read_bytes())
    return contents


def describe(error: BadInput) -> dict[str, Any]:
    """Return an error as JSON for a page; `words` is the text of the command line."""
    value = None if error.value is None else str(error.value)[:200]
    return {"field": "", "line": None} | error.told() | {"value": value, "words": str(error)}


class Server(ThreadingHTTPServer):
    """Serves the page on a free port of loopback, with a thread for each of a few connections.

    `act` carries out the page's requests; the page shows its BadInput. `resources` answer addresses other than the
    page's files. `take` receives files that are dropped on the page.
    """

    daemon_threads = True
    request_queue_size = 4 * MOST_CONNECTIONS

    def __init__(self, act: Act, resources: Mapping[str, Resource], take: Take | None = None) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.guard = Guard(int(self.server_address[1]))
        self.act, self.resources, self.take, self.files = act, resources, take, page_files()
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


# Access control of the page's server: it answers only the page that was opened by the address it printed.
#
# A server on loopback can be reached by any page that is open in a browser of this machine. Three checks keep those
# out. The path begins with a random token, which no other page knows; the `Host` must be this server's own, which
# defeats names that were made to point here (DNS rebinding); and the `Origin`, if the browser sends one, must be this
# page's. Requests that change something must have an `Origin`, which browsers always send then.

TOKEN_BYTES = 24
FORBIDDEN, LENGTH_REQUIRED, TOO_LARGE, UNSUPPORTED = 403, 411, 413, 415
MOST_BYTES = 4_000_000
"""Largest body of a request: 100,000 points of lines fit."""
JSON, FILE = "application/json", "application/octet-stream"
"""Media types of requests: JSON, and a file's bytes."""
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
"""Headers of every answer: the page loads nothing from elsewhere, and is not framed, cached, or sent as a referrer."""


class Refused(Exception):
    """A refused request: an HTTP status and a sentence."""

    def __init__(self, status: int, why: str) -> None:
        super().__init__(why)
        self.status, self.why = status, why


@dataclass(frozen=True)
class Guard:
    """Checks of one server at a port of loopback."""

    port: int
    token: str = field(default_factory=lambda: secrets.token_urlsafe(TOKEN_BYTES))

    @property
    def address(self) -> str:
        """The address to open in a browser."""
        return f"http://127.0.0.1:{self.port}/{self.token}/"

    def check(self, method: str, path: str, headers: Message) -> str:
        """Return the requested path below the token. Raises Refused."""
        allowed = {f"127.0.0.1:{self.port}", f"localhost:{self.port}"}
        hosts = headers.get_all("Host") or []
        if len(hosts) != 1 or hosts[0] not in allowed:
            raise Refused(FORBIDDEN, "this is not the host that was asked for")
        token, _, rest = path.removeprefix("/").partition("/")
        if not secrets.compare_digest(token.encode(), self.token.encode()):
            raise Refused(FORBIDDEN, "open the whole address that nuno printed")
        origins = headers.get_all("Origin") or []
        same = len(origins) == 1 and origins[0] == f"http://{hosts[0]}"
        if not same and (origins or method == "POST"):
            raise Refused(FORBIDDEN, "another page may not ask here")
        # Another page, such as a terminal in a browser, may have a link to the whole address.
        followed = method == "GET" and headers.get("Sec-Fetch-Mode") == "navigate"
        if not followed and headers.get("Sec-Fetch-Site", "same-origin") not in ("same-origin", "none"):
            raise Refused(FORBIDDEN, "another page may not ask here")
        return rest

    def length(self, headers: Message, most: int = MOST_BYTES, kind: str = JSON) -> int:
        """Return the length of a body of the media type `kind` [bytes]. Raises Refused."""
        text = headers.get("Content-Length", "")
        if "Transfer-Encoding" in headers or not (text.isascii() and text.isdigit()):
            raise Refused(LENGTH_REQUIRED, "a request says how long it is")
        if len(text) > 12 or int(text) > most:
            raise Refused(TOO_LARGE, f"a request has at most {most} bytes")
        # Forms and images of other pages cannot send these types without a preflight request.
        if headers.get_content_type() != kind:
            raise Refused(UNSUPPORTED, f"a request is {kind}")
        return int(text)
