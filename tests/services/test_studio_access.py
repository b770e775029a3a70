"""Who gets at the page of `nuno studio`, its files and what it does: nobody but the page that was opened.

As for `nuno draw` (test_draw.py), with what is sent to the studio and fetched from it as files.
"""

from __future__ import annotations

import http.client
import json
import os
import re
import socket
import stat
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import psutil
import pytest
from browser import Page
from live_run import PATIENCE, wait_until
from studio_desk import FILE, NEEDS_BROWSER, studio, write_sheet

from nuno.scene import shipped
from nuno.studio import dropped_files as arrivals
from nuno.studio.desk import Desk
from nuno.studio.server import FILE as BYTES
from nuno.studio.server import JSON, MOST_BYTES, MOST_CONNECTIONS, Server, door

NET = (shipped.folder() / "pendulum.npz").read_bytes()
NOW = b'{"do": "now"}'
READ = ("", "main.js", "schema", "drawn?name=net", "shown?file=a.png", "picture?recording=a.mcap",
        "exported?recording=a.mcap&kind=csv")  # fmt: skip


@pytest.fixture
def served(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[Desk, Server]]:
    folder = tmp_path / "mine"
    folder.mkdir()
    monkeypatch.chdir(folder)
    write_sheet(folder)
    with studio() as both:
        yield both


def ask(server: Server, path: str, data: bytes | None = None, token: str | None = None, **headers: str | None) -> int:
    """The status of what the page itself would ask, but for what is given; what is not answered in full is closed."""
    guard = server.guard
    host = f"127.0.0.1:{guard.port}"
    given: dict[str, str | None] = {"Host": host}
    if data is not None:
        kind = BYTES if path.startswith("file") else JSON
        given |= {"Origin": f"http://{host}", "Content-Type": kind, "Content-Length": str(len(data))}
    given |= {name.replace("_", "-"): value for name, value in headers.items()}
    connection = http.client.HTTPConnection("127.0.0.1", guard.port, timeout=60)
    connection.putrequest("GET" if data is None else "POST", f"/{guard.token if token is None else token}/{path}", True)
    for name, value in given.items():
        if value is not None:
            connection.putheader(name, value)
    connection.endheaders(data)
    answer = connection.getresponse()
    assert "default-src 'none'" in (answer.getheader("Content-Security-Policy") or "")
    assert answer.getheader("Access-Control-Allow-Origin") is None
    assert answer.getheader("Cross-Origin-Resource-Policy") == "same-origin"
    return answer.status


STRANGE: list[dict[str, Any]] = [
    {"token": ""}, {"token": "A" * 32}, {"Host": "evil.example"}, {"Host": None}, {"Origin": "http://evil.example"},
    {"Origin": "null"}, {"Sec_Fetch_Site": "cross-site"}, {"Sec_Fetch_Site": "same-site"},
]  # fmt: skip


@pytest.mark.parametrize("strange", STRANGE, ids=str)
def test_a_stranger_reads_nothing_and_sends_nothing(served: tuple[Desk, Server], strange: dict[str, Any]) -> None:
    server = served[1]
    for path in READ:
        assert ask(server, path, **strange) == 403
    assert ask(server, "file?name=a.npz", NET, **strange) == 403
    assert ask(server, "do", json.dumps({"do": "delete", "recording": "a.mcap"}).encode(), **strange) == 403
    assert [path.name for path in Path().iterdir()] == [FILE]


@pytest.mark.parametrize(
    ("status", "more"),
    [
        (403, {"Origin": None}),
        (415, {"Content_Type": "text/plain"}),
        (415, {"Content_Type": "multipart/form-data; boundary=a"}),
        (415, {"Content_Type": JSON}),
        (411, {"Content_Length": None}),
        (411, {"Transfer_Encoding": "chunked"}),
        (413, {"Content_Length": str(arrivals.MOST + 1)}),
        (200, {}),
    ],
)
def test_a_file_is_taken_as_the_page_sends_it_and_no_other_way(
    served: tuple[Desk, Server], status: int, more: dict[str, Any]
) -> None:
    assert ask(served[1], "file?name=a.npz", NET, **more) == status
    assert Path("a.npz").is_file() == (status == 200)


def test_connections_that_say_nothing_keep_nobody_out(served: tuple[Desk, Server]) -> None:
    server = served[1]
    held = http.client.HTTPConnection("127.0.0.1", server.guard.port, timeout=10)
    held.putrequest("POST", f"/{server.guard.token}/do")
    for name, value in {"Origin": f"http://127.0.0.1:{server.guard.port}", "Content-Type": JSON}.items():
        held.putheader(name, value)
    held.putheader("Content-Length", str(len(NOW)))
    held.endheaders(NOW[:5])  # the page's own, which is slow
    crowd = []
    for i in range(MOST_CONNECTIONS + 8):
        crowd.append(socket.create_connection(("127.0.0.1", server.guard.port), timeout=10))
        if i % 2:
            crowd[-1].sendall(b"GET / HTTP/1.1\r\nHost: ")
    start = time.monotonic()
    for _ in range(5):
        assert ask(server, "schema") == 200
    assert time.monotonic() - start < 5.0
    held.send(NOW[5:])
    assert held.getresponse().status == 200
    for one in crowd:
        one.close()


def test_what_was_not_read_is_no_other_request(served: tuple[Desk, Server]) -> None:
    """The bytes of a file that is refused before it is read are not taken for what is asked next."""
    server = served[1]
    host = f"127.0.0.1:{server.guard.port}"
    connection = http.client.HTTPConnection("127.0.0.1", server.guard.port, timeout=10)
    headers = {"Host": host, "Origin": f"http://{host}", "Content-Type": BYTES}
    connection.request("POST", f"/{server.guard.token}/file?name=a.exe", b"DELETE /all HTTP/1.1\r\n\r\n", headers)
    answer = connection.getresponse()
    assert json.loads(answer.read())["ok"] is False and answer.getheader("Connection") == "close"


def test_a_fault_is_told_without_the_address(served: tuple[Desk, Server], caplog: pytest.LogCaptureFixture) -> None:
    server = served[1]
    server.act = lambda request: {"half": 1 / int(request["by"])}
    assert ask(server, "do", b'{"by": 0}') == 500
    assert "ZeroDivisionError" in caplog.text and server.guard.token not in caplog.text


def test_words_are_as_short_as_ever_and_files_are_taken_at_one_place(served: tuple[Desk, Server]) -> None:
    assert ask(served[1], "do", b"", Content_Length=str(MOST_BYTES + 1)) == 413
    assert ask(served[1], "do", NET, Content_Type=BYTES) == 415
    assert ask(served[1], "other", b"{}") == 404
    for path in (
        "../sheet.yaml",
        "sheet.yaml",
        "drawn?name=../sheet",
        "shown?file=../mine/sheet.yaml",
        "..%2fsheet.yaml",
    ):
        assert ask(served[1], path) == 404


@pytest.fixture
def begun(tmp_path: Path) -> Iterator[tuple[psutil.Process, str]]:
    """`nuno studio` as a person begins it, and its token."""
    write_sheet(tmp_path)
    command = [sys.executable, "-m", "nuno", "studio", "--no-browser"]
    with subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        token = re.search(r"127\.0\.0\.1:\d+/([\w-]{32,})/", process.stdout.readline())
        assert token is not None
        yield psutil.Process(process.pid), token[1]
        process.terminate()


def test_another_user_of_the_machine_does_not_learn_the_token(
    begun: tuple[psutil.Process, str], tmp_path: Path
) -> None:
    process, token = begun
    for one in (process, *process.children(recursive=True)):
        assert token not in " ".join(one.cmdline()) and token not in " ".join(one.environ().values())
    (listens,) = (one for one in process.net_connections("inet") if one.status == psutil.CONN_LISTEN)
    assert listens.laddr.ip == "127.0.0.1"
    for path in tmp_path.rglob("*"):
        assert not path.is_file() or token.encode() not in path.read_bytes()


def test_a_browser_is_started_by_a_file_of_this_users_alone() -> None:
    with door("http://127.0.0.1:1/secret/") as uri:
        path = Path(uri.removeprefix("file://"))
        assert "secret" not in uri and "http://127.0.0.1:1/secret/" in path.read_text()
        for one in (path, path.parent):
            assert not stat.S_IMODE(one.stat().st_mode) & 0o077 and one.stat().st_uid == os.getuid()
    assert not path.exists()


class Elsewhere(BaseHTTPRequestHandler):
    """Another page in the same browser, with nothing in it."""

    def do_GET(self) -> None:
        self.send_response(200)
        self.send_header("Content-Type", "text/html")
        self.end_headers()
        self.wfile.write(b"<!doctype html><title>elsewhere</title><body></body>")

    def log_message(self, format: str, *args: Any) -> None:
        """Nothing."""


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    # As a name is made to point here that pointed to its owner's server before.
    flags = '--host-resolver-rules="MAP evil.example 127.0.0.1" --disable-popup-blocking'
    with Page(tmp_path_factory.mktemp("browser"), flags=flags) as page:
        yield page


@pytest.fixture
def elsewhere() -> Iterator[int]:
    server = ThreadingHTTPServer(("127.0.0.1", 0), Elsewhere)
    threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True).start()
    yield int(server.server_address[1])
    server.shutdown()
    server.server_close()


ATTACK = Path(__file__).with_name("stranger.js").read_text()


def attack(browser: Page, address: str) -> set[str]:
    """What the page that is open gets at by all that it may try."""
    return set(browser.value(ATTACK.replace("ADDRESS", json.dumps(address))))


@pytest.mark.full
@NEEDS_BROWSER
@pytest.mark.parametrize("host", ["127.0.0.1", "localhost"])
def test_a_page_of_another_origin_that_even_knows_the_address_gets_nothing_done(
    browser: Page, served: tuple[Desk, Server], elsewhere: int, host: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, server = served
    done: list[str] = []
    act = server.act

    def note(request: Mapping[str, Any]) -> dict[str, Any]:
        done.append(str(request.get("do")))
        return act(request)

    monkeypatch.setattr(server, "act", note)
    browser.open(f"http://{host}:{elsewhere}/")
    browser.wait("document.title === 'elsewhere'")
    assert attack(browser, server.guard.address) == set()
    # The window that was opened is the user's own page, which the other cannot see into: it asks for what it shows.
    assert set(done) <= {"scenes", "now"} and done.count("scenes") <= 1
    assert [path.name for path in Path().iterdir()] == [FILE]
    # Tried from the page itself, the same gets it what may be got.
    browser.open(server.guard.address)
    browser.wait("document.querySelectorAll('.cards li').length > 5", PATIENCE)
    got = attack(browser, server.guard.address)
    assert {"fetch schema", "image", "script", "style", "window"} <= got and Path("x.yaml").is_file()


@pytest.mark.full
@NEEDS_BROWSER
def test_a_name_that_is_made_to_point_here_gets_nothing(browser: Page, served: tuple[Desk, Server]) -> None:
    server = served[1]
    address = server.guard.address.replace("127.0.0.1", "evil.example")
    browser.open(address)
    browser.wait("location.host.startsWith('evil.example') && document.body?.textContent.includes('403')")
    read = "fetch('{}').then((a) => a.status)"
    for path in ("", "schema", "drawn?name=net"):
        assert browser.value(read.format(path or ".")) == 403
    sent = "fetch('{}', {{ method: 'POST', headers: {{ 'Content-Type': '{}' }}, body: '{{}}' }}).then((a) => a.status)"
    assert browser.value(sent.format("do", JSON)) == 403
    assert browser.value(sent.format("file?name=x.npz", BYTES)) == 403
    assert [path.name for path in Path().iterdir()] == [FILE]


@pytest.mark.full
@NEEDS_BROWSER
def test_the_file_that_starts_a_browser_leads_to_the_page(browser: Page, served: tuple[Desk, Server]) -> None:
    with door(served[1].guard.address) as uri:
        browser.open(uri)
        browser.wait("document.querySelectorAll('.cards li').length > 5", PATIENCE)


def test_what_is_made_for_the_page_is_this_users_alone(served: tuple[Desk, Server]) -> None:
    folder = Path(served[0].exports.folder)
    assert not stat.S_IMODE(folder.stat().st_mode) & 0o077
    seen: list[int] = []

    def look(path: Path) -> None:
        seen.append(stat.S_IMODE(path.parent.stat().st_mode))

    with (shipped.folder() / "pendulum.npz").open("rb") as stream:
        arrivals.Arrivals(Path(), {}).receive("a.npz", stream, len(NET), look)
    assert seen == [0o700]
    wait_until(lambda: [path.name for path in sorted(Path().iterdir())] == ["a.npz", FILE])
