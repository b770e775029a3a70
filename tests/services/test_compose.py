"""docker-compose.yml: valid, consistent, its very commands run as plain processes, and who leaves last."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

import nuno
from nuno.bus import credentials
from nuno.bus.sessions import free_port

FILE = Path(__file__).resolve().parents[2] / "docker-compose.yml"
ROLES = {"run": "supervisor"}
"""Containers that are not called after their role."""


@pytest.fixture(scope="module")
def compose() -> dict[str, Any]:
    data: dict[str, Any] = yaml.safe_load(FILE.read_text())
    return data


def test_file_fits_the_compose_schema() -> None:
    checker = Path(sys.executable).with_name("check-jsonschema")
    command = [str(checker), "--builtin-schema", "vendor.compose-spec", str(FILE)]
    result = subprocess.run(command, capture_output=True, text=True)
    assert result.returncode == 0, result.stdout


def test_everything_it_names_is_there(compose: dict[str, Any]) -> None:
    services = compose["services"]
    for name, service in services.items():
        assert set(service.get("depends_on", [])) <= set(services)
        assert set(service["networks"]) <= set(compose["networks"])
        role, *others = service["volumes"]
        assert role == f"./certs/{ROLES.get(name, name)}.json5:/role.json5:ro", "a role's file, and no other's"
        assert {volume.split(":")[0] for volume in others} <= set(compose["volumes"])
    assert compose["networks"]["bus"]["internal"] is True


def test_every_container_needs_a_certificate(compose: dict[str, Any]) -> None:
    for service in compose["services"].values():
        command = service["command"]
        assert command[command.index("--config") + 1] == "/role.json5"
        assert command[command.index("--listen" if "--listen" in command else "--connect") + 1].startswith("tls/")


@pytest.mark.full
def test_its_commands_make_a_complete_recording(compose: dict[str, Any], tmp_path: Path) -> None:
    """With the certificates that `nuno certs` makes, each service with its own."""
    port = free_port()
    swaps = {"tls/0.0.0.0:7447": f"tls/127.0.0.1:{port}", "tls/router:7447": f"tls/localhost:{port}"}
    credentials.make(tmp_path / "certs", ("localhost",), credentials.roles(), 1)

    def command(name: str) -> list[str]:
        words = [swaps.get(word, word) for word in compose["services"][name]["command"]]
        role = str(tmp_path / "certs" / f"{ROLES.get(name, name)}.json5")
        words = [word.replace("/recordings", str(tmp_path)).replace("/role.json5", role) for word in words]
        short = [] if name == "router" else ["--set", "duration=0.1"]
        return [sys.executable, "-m", "nuno", *words, *short]

    children = {n: subprocess.Popen(command(n), stdout=subprocess.DEVNULL) for n in compose["services"]}
    try:
        codes = {"run": children["run"].wait(150)}
        # What starts the containers goes on from here: nobody may be needed any more.
        with nuno.open(tmp_path / "skirt.mcap") as recording:
            assert recording.complete
            assert recording.counts["sim/state"] == 7
        codes |= {name: children[name].wait(30) for name in children if name not in ("router", "run")}
    finally:
        for child in children.values():
            child.terminate()
        assert children["router"].wait(20) == 0
    assert set(codes.values()) == {0}, codes


def test_the_commands_it_gives_follow_the_service_that_leaves_last(compose: dict[str, Any]) -> None:
    """`run` asks the others to finish, and starts them: what a user types must wait for it alone."""
    given = [line.split("#")[1].split() for line in FILE.read_text().splitlines() if line.startswith("#   ")]
    assert given == [
        ["nuno", "certs", "certs", "--hosts", "router"],
        ["docker", "compose", "run", "--rm", "run"],
        ["docker", "compose", "down"],
    ]
    assert set(compose["services"]["run"]["depends_on"]) == set(compose["services"]) - {"run"}
