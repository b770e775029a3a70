"""Who gets in: certificates, passwords of a zenoh configuration, and what listens at all."""

from __future__ import annotations

import base64
import importlib.util
import json
import socket
import stat
import threading
from contextlib import suppress
from pathlib import Path
from typing import Any

import psutil
import pytest
from cryptography import x509
from cryptography.x509.oid import ExtendedKeyUsageOID
from refusals import largest_file
from scenes import BALL, write_scene

import nuno
from nuno.bus import credentials
from nuno.bus import credentials as certificates
from nuno.bus.credentials import IN, PEOPLE, Rights, access_control, read_rights
from nuno.bus.messages import Bus, Inbox, Message, Query
from nuno.bus.sessions import free_port, hub, spoke
from nuno.cli import main
from nuno.runtime import runs, supervisor
from nuno.runtime.service import MODULES, SUPERVISOR
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.messages import ACK, EVENT, REPORT, STATE, TOPICS
from soak import access, scenes
from soak.processes import Processes


def test_nobody_gets_in_without_the_certificate_for_it() -> None:
    results = access.run(quick=True, seed=0)
    assert [f"{r.case}: {r.failure or r.median}" for r in results if r.verdict in ("missed", "failed")] == []
    assert len(results) >= 15


@pytest.mark.full
def test_without_access_control_the_same_attempts_succeed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def none(roles: Any) -> dict[str, Any]:
        return {"enabled": False}

    monkeypatch.setattr(credentials, "access_control", none)
    with access.guarded_run(tmp_path) as guarded:
        spared = Rights(asks=("finish/*",))  # the run is to be stopped by its operator
        # The hub waits for the run's services alone: to an observer that lags it may drop what was forged.
        tries = (access.attempt(guarded, guarded.endpoint, guarded.config("collision"), spared) for _ in range(5))
        got = any(one is not None and min(one) > 0 for one in tries)
    assert got, "messages read, requests taken, forgeries delivered"


@pytest.mark.full
def test_a_run_is_heard_by_observers_and_its_bodies_are_operators(tmp_path: Path) -> None:
    """From another host, where nothing but the certificate says who one is."""
    with access.guarded_run(tmp_path) as guarded:
        run, endpoint, (operator, observer) = guarded.run, guarded.endpoint, map(guarded.config, PEOPLE)
        with nuno.watch(run, "sim/status", connect=endpoint, config=observer) as heard:
            assert next(heard).value.state == "running"
        with pytest.raises(BadInput, match=r"ball has no motion: {plugin: topic}"):
            nuno.drive(run, "ball", connect=endpoint, config=operator)
        with pytest.raises(RunFailed, match="an operator's certificate"):
            nuno.drive(run, "ball", connect=endpoint, config=observer)
        with pytest.raises(BadInput, match="no such run"):
            nuno.watch("other", connect=endpoint, config=observer)
        guarded.stop()


@pytest.fixture(scope="module")
def certs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("made") / "certs"
    credentials.make(path, ("router", "10.0.0.1"), credentials.roles(), 30)
    return path


def secrets(path: Path) -> dict[str, Any]:
    tls: dict[str, Any] = json.loads(path.read_text())["transport"]["link"]["tls"]
    return tls


def certificate(path: Path) -> x509.Certificate:
    tls = secrets(path)
    (text,) = (tls[name] for name in tls if name.endswith("certificate_base64") and not name.startswith("root"))
    return x509.load_pem_x509_certificate(base64.b64decode(text))


def test_only_the_owner_reads_the_files(certs: Path) -> None:
    assert stat.S_IMODE(certs.stat().st_mode) == 0o700
    assert {stat.S_IMODE(path.stat().st_mode) for path in certs.iterdir()} == {0o600}


def test_a_role_has_its_own_key_and_no_other(certs: Path) -> None:
    keys = [secrets(certs / f"{role}.json5") for role in credentials.roles()]
    private = [tls[name] for tls in keys for name in tls if "private_key" in name]
    assert len(set(private)) == len(credentials.roles())
    authority = base64.b64encode((certs / "authority.key").read_bytes()).decode()
    assert authority not in private


def test_only_the_router_can_be_a_server(certs: Path) -> None:
    for role in credentials.roles():
        found = certificate(certs / f"{role}.json5")
        usage = found.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
        serves = ExtendedKeyUsageOID.SERVER_AUTH in usage
        assert (serves, len(usage), certificates.name_of(found)) == (role == "router", 1, role)
    assert certificates.hosts_of(certificate(certs / "router.json5")) == ["router", "10.0.0.1"]


def test_nothing_is_overwritten(certs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = {path: path.read_bytes() for path in certs.iterdir()}
    assert main(["certs", str(certs), "--roles", "observer,router"]) == 2
    assert "would be overwritten" in capsys.readouterr().err
    assert {path: path.read_bytes() for path in certs.iterdir()} == before


def test_a_full_disk_leaves_no_part_of_an_authority(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A key without its certificate, or half of a file, would be in the way of the next try."""
    for room in (100, 1000):
        with largest_file(room):
            assert main(["certs", str(tmp_path / "certs")]) == 2
        assert "cannot be written: File too large" in capsys.readouterr().err
        assert list((tmp_path / "certs").iterdir()) == []
    assert main(["certs", str(tmp_path / "certs"), "--roles", "observer"]) == 0


def test_one_that_was_moved_away_is_made_again_by_the_same_authority(certs: Path, tmp_path: Path) -> None:
    (certs / "dye.json5").rename(tmp_path / "old.json5")
    assert main(["certs", str(certs), "--roles", "dye"]) == 0
    assert [kept.wrong for kept in credentials.check(certs)] == [""] * len(credentials.roles())


@pytest.mark.parametrize(
    ("hosts", "roles", "days", "problem"),
    [
        (("router",), ["observers"], 30, "no such role"),
        (("a b",), ["router"], 30, "neither a host's name nor an address"),
        (("",), ["router"], 30, "neither a host's name nor an address"),
        (("router",), ["router"], 0, "holds for 1 day or more"),
        (("router",), ["router"], 10**9, "holds for 1 day or more"),
    ],
)
def test_what_cannot_be_made_is_said(
    hosts: tuple[str, ...], roles: list[str], days: int, problem: str, tmp_path: Path
) -> None:
    with pytest.raises(BadInput, match=problem):
        credentials.make(tmp_path / "certs", hosts, roles, days)
    assert not list(tmp_path.iterdir()), "nothing is written"


def test_check_names_what_is_amiss(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, other = tmp_path / "certs", tmp_path / "other"
    assert main(["certs", str(path), "--check"]) == 2
    credentials.make(path, ("router",), ["router", "dye", "render", "viewer", "observer", "operator"], 1)
    credentials.make(other, ("router",), ["viewer"], 1)
    authority = certificates.load((path / "authority.pem").read_bytes(), (path / "authority.key").read_bytes())
    old = credentials.configuration("dye", certificates.sign(authority, "dye", -1), authority)
    (path / "dye.json5").write_bytes(old)
    (path / "viewer.json5").write_bytes((other / "viewer.json5").read_bytes())
    (path / "render.json5").write_bytes((path / "observer.json5").read_bytes())
    (path / "router.json5").chmod(0o644)
    (path / "operator.json5").write_text("{}")
    found = {kept.role: kept.wrong for kept in credentials.check(path)}
    assert "expired" in found["dye"]
    assert "another authority" in found["viewer"] and "another role's" in found["render"]
    assert "chmod 600" in found["router"] and "cannot be used" in found["operator"]
    assert found["observer"] == ""
    capsys.readouterr()
    assert main(["certs", str(path), "--check"]) == 1
    assert "expired" in capsys.readouterr().out


def test_each_topic_is_published_by_the_service_that_makes_it_and_by_no_other() -> None:
    rights = read_rights()
    assert set(rights) == {*MODULES, SUPERVISOR, "operator", "observer"}
    for topic in set(TOPICS) - {EVENT.name, ACK.name, REPORT.name}:
        owners = [role for role, right in rights.items() if topic in right.publishes]
        assert len(owners) == 1, (topic, owners)
    for role, right in rights.items():
        named = [topic for topic in right.publishes if (role, topic) != ("operator", "poses/*")]  # a scene's bodies
        assert not any("*" in topic for topic in named), "each topic is named"
        spoken = {topic.rpartition("/")[2] for topic in right.publishes if topic.startswith(("run/event/", "ack/"))}
        assert spoken <= {role}, "nobody speaks for another"
    assert [role for role, right in rights.items() if "control" in right.asks] == ["supervisor", "operator"]
    assert rights["observer"].asks == ("health/*",)  # counts, for nuno top: nothing is changed by it
    assert not rights["observer"].publishes and not rights["observer"].answers


def test_what_is_not_allowed_is_denied() -> None:
    control = access_control(read_rights())
    assert control["default_permission"] == "deny"
    assert {rule["permission"] for rule in control["rules"]} == {"allow"}
    rules = {rule["id"]: rule for rule in control["rules"]}
    assert len(rules) == len(control["rules"])
    for policy in control["policies"]:
        sent = [rules[name] for name in policy["rules"] if rules[name]["flows"] == [IN]]
        own = {key for rule in sent for key in rule["key_exprs"] if "put" in rule["messages"]}
        assert own == {f"nuno/*/{topic}" for topic in read_rights()[policy["subjects"][0]].publishes}


@pytest.fixture
def config(tmp_path: Path) -> str:
    """A configuration by which a hub asks for a password, and a spoke gives it."""
    (tmp_path / "users.txt").write_text("anna:secret")
    user = {"user": "anna", "password": "secret", "dictionary_file": str(tmp_path / "users.txt")}
    path = tmp_path / "zenoh.json5"
    path.write_text(json.dumps({"transport": {"auth": {"usrpwd": user}}}))
    return str(path)


def test_who_has_no_password_is_not_let_in(config: str) -> None:
    """What the other tests rest on."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with hub(endpoint, config):
        with spoke(endpoint, config):
            pass
        with pytest.raises(BadInput, match="something listens there"), spoke(endpoint):
            pass


@pytest.mark.full
def test_services_in_processes_of_their_own_are_let_in(config: str, tmp_path: Path) -> None:
    record = tmp_path / "run.mcap"
    scene = write_scene(tmp_path, bodies=BALL, duration=0.1)
    command = ["run", str(scene), "--processes", "--config", config, "--record", str(record), "--no-view"]
    assert main(command) == 0
    with nuno.open(record) as recording:
        assert recording.complete


def test_control_is_let_in(config: str, capsys: pytest.CaptureFixture[str]) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with hub(endpoint, config) as session, runs.announced("guarded", endpoint):
        inbox = Inbox(Bus(session, "guarded", "simulation"), [])
        inbox.answer("control")
        answer = {"ok": True, "state": "paused", "frame": 3, "frames": 25, "t": 0.06}

        def reply() -> None:
            question = inbox.get(20.0)
            assert isinstance(question, Query)
            question.answer_json(answer)

        thread = threading.Thread(target=reply, daemon=True)
        thread.start()
        assert main(["control", "guarded", "status", "--config", config]) == 0
        thread.join(20.0)
        assert "paused at frame 3 of 25" in capsys.readouterr().out
        assert main(["control", "guarded", "status"]) == 2


@pytest.mark.full
def test_a_replay_asks_for_the_password(config: str, tmp_path: Path) -> None:
    record = tmp_path / "run.mcap"
    nuno.run(write_scene(tmp_path, duration=0.1), record=record)
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    flags = ["--listen", endpoint, "--run", "again", "--no-view", "--rate", "0.04", "--config", config]
    command = ["replay", str(record), *flags]
    thread = threading.Thread(target=main, args=(command,), daemon=True)
    thread.start()
    with spoke(endpoint, config, supervisor.CONNECT_PATIENCE) as session:
        inbox = Inbox(Bus(session, "again", "listener"), [STATE], newest_only=True)
        assert isinstance(inbox.get(20.0), Message)
        with pytest.raises(BadInput, match="something listens there"), spoke(endpoint):
            pass
    thread.join(30.0)
    assert not thread.is_alive()


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


@pytest.mark.full
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


def test_a_hub_that_is_there_and_that_no_session_reaches_is_told_from_none(tmp_path: Path) -> None:
    credentials.make(tmp_path / "ours", ("127.0.0.1",), ["router", "operator"], 1)
    credentials.make(tmp_path / "theirs", ("127.0.0.1",), ["operator"], 1)
    port, ours = free_port(), tmp_path / "ours"
    with hub(f"tls/127.0.0.1:{port}", str(ours / "router.json5")):
        for endpoint, config in (
            (f"tls/127.0.0.1:{port}", tmp_path / "theirs" / "operator.json5"),
            (f"tls/localhost:{port}", ours / "operator.json5"),
            (f"tcp/127.0.0.1:{port}", None),
        ):
            with (
                pytest.raises(BadInput, match="something listens there") as caught,
                spoke(endpoint, str(config) if config else None, 0.1),
            ):
                pass
            assert "--config: authority" in str(caught.value)
        with spoke(f"tls/127.0.0.1:{port}", str(ours / "operator.json5"), 5.0):
            pass
    with pytest.raises(BadInput, match="nothing answers there"), spoke(f"tcp/127.0.0.1:{free_port()}", None, 0.1):
        pass


def test_a_service_refuses_the_certificate_of_another_role(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    credentials.make(tmp_path / "certs", ("127.0.0.1",), ["recorder"], 1)
    words = ["serve", "collision", "hanging-sheet", "--run", "r1", "--connect", "tls/127.0.0.1:1", "--config"]
    assert main([*words, str(tmp_path / "certs" / "recorder.json5")]) == 2
    assert "this is the certificate of recorder" in capsys.readouterr().err


def test_a_hub_that_others_reach_without_a_certificate_is_warned_of(capsys: pytest.CaptureFixture[str]) -> None:
    for host in ("0.0.0.0", "127.0.0.1", "localhost"):
        with hub(f"tcp/{host}:{free_port()}"):
            assert ("nuno certs makes certificates" in capsys.readouterr().err) == (host == "0.0.0.0")
