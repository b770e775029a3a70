"""Access control of the page's server: it answers only the page that was opened by the address it printed.

A server on loopback can be reached by any page that is open in a browser of this machine. Three checks keep those out.
The path begins with a random token, which no other page knows; the `Host` must be this server's own, which defeats
names that were made to point here (DNS rebinding); and the `Origin`, if the browser sends one, must be this page's.
Requests that change something must have an `Origin`, which browsers always send then.
"""

from __future__ import annotations

import secrets
from dataclasses import dataclass, field
from email.message import Message

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
