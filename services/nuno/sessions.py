"""zenoh sessions that expose nothing: loopback unless told otherwise, no scouting."""

from __future__ import annotations

import json
import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import zenoh

from nuno_schemas.errors import BadInput

LEASE_MS = 2000
"""A peer that stays silent this long is gone; zenoh's default of 10 s hides a dead service."""


ATTEMPTS = 20
"""Free ports that are tried: between finding one and listening there another run may take it."""


class PortTaken(BadInput):
    """Another program listens at the endpoint."""


def free_port() -> int:
    """A TCP port on loopback that is free now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _config(mode: str, listen: list[str], connect: list[str], extra: str | None) -> zenoh.Config:
    try:
        config = zenoh.Config.from_file(extra) if extra else zenoh.Config()
    except (zenoh.ZError, OSError) as error:
        remedy = "give a zenoh configuration file (JSON5)"
        raise BadInput(f"cannot be read: {_short(error)}", field="--config", value=extra, remedy=remedy) from None
    settings: dict[str, Any] = {
        "mode": mode,
        "listen/endpoints": listen,
        "connect/endpoints": connect,
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        # Nobody is scouted for, so nothing is gained by waiting half a second for an answer.
        "scouting/delay": 0,
        "transport/link/tx/lease": LEASE_MS,
    }
    for key, value in settings.items():
        try:
            config.insert_json5(key, json.dumps(value))
        except zenoh.ZError:
            raise BadInput("not an endpoint", value=value[0], remedy="for example tcp/127.0.0.1:7447") from None
    return config


@contextmanager
def hub(endpoint: str, extra: str | None = None) -> Iterator[zenoh.Session]:
    """A session that others connect to, e.g. "tcp/127.0.0.1:7447". Raises PortTaken, BadInput.

    `extra` is a zenoh configuration file (TLS, access control) that is read first.
    """
    config = _config("router", [endpoint], [], extra)
    try:
        session = zenoh.open(config)
    except zenoh.ZError as error:
        if "in use" in str(error):
            remedy = "choose another port, or leave --listen out for a free one"
            raise PortTaken("another program listens there", value=endpoint, remedy=remedy) from None
        remedy = "check the endpoint"
        raise BadInput(f"cannot listen: {_short(error)}", value=endpoint, remedy=remedy) from None
    with session:
        yield session


@contextmanager
def hub_at(listen: str | None, extra: str | None = None) -> Iterator[tuple[zenoh.Session, str]]:
    """A hub and its endpoint: the one given, or a free port of loopback. Raises as `hub`."""
    with ExitStack() as stack:
        for left in reversed(range(1 if listen else ATTEMPTS)):
            endpoint = listen or f"tcp/127.0.0.1:{free_port()}"
            try:
                session = stack.enter_context(hub(endpoint, extra))
                break
            except PortTaken:
                if not left:
                    raise
        yield session, endpoint


@contextmanager
def spoke(endpoint: str, extra: str | None = None, patience: float = 0.0) -> Iterator[zenoh.Session]:
    """A session connected to a hub. Raises BadInput if there is none within `patience` [s]."""
    config = _config("client", [], [endpoint], extra)
    config.insert_json5("connect/timeout_ms", json.dumps(round(1000 * patience)))
    try:
        session = zenoh.open(config)
    except zenoh.ZError as error:
        raise BadInput(
            f"nothing answers there: {_short(error)}",
            value=endpoint,
            remedy="start the hub first (nuno serve router), or check --connect",
        ) from None
    with session:
        yield session


def _short(error: Exception) -> str:
    return str(error).split(" at /")[0].strip()
