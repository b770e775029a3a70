"""The rights of roles, from deploy/access.yaml to zenoh's access control, which a router enforces.

zenoh names nine kinds of messages and two directions, seen from the router: what comes in from a client (ingress) and
what goes out to it (egress). Each right needs several of them: who reads a topic declares a subscriber and is sent
what is put; who asks sends a query and is sent the reply; who answers declares a queryable, is sent the query and
replies. A role is the common name of a client's certificate, so nobody takes another one's.

A wildcard is matched by inclusion: who may publish `sim/state` of every run cannot publish `**`, nor subscribe to it.
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import yaml
from pydantic import BaseModel, ConfigDict

IN, OUT = "ingress", "egress"
RIGHTS: dict[str, tuple[tuple[str, str], ...]] = {
    "publishes": (("put", IN),),
    "reads": (("declare_subscriber", IN), ("put", OUT)),
    "answers": (("declare_queryable", IN), ("query", OUT), ("reply", IN)),
    "asks": (("query", IN), ("reply", OUT)),
}
"""Messages and directions of each right."""
ALIVE = (("declare_liveliness_subscriber", IN), ("liveliness_query", IN), ("liveliness_token", OUT))
"""The same of seeing who is alive, from now on and now."""
PEOPLE = ("operator", "observer")
"""Roles that are no part of a run."""


class Rights(BaseModel):
    """What one role may do: topics below `nuno/RUN/`, as key expressions."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    publishes: tuple[str, ...] = ()
    reads: tuple[str, ...] = ()
    answers: tuple[str, ...] = ()
    asks: tuple[str, ...] = ()


def deploy_folder() -> Path:
    """Where the files of a deployment lie: beside the sources, or in the package that was installed."""
    beside = Path(__file__).resolve().parents[3] / "deploy"
    return beside if beside.is_dir() else Path(str(files("nuno"))) / "deploy"


def read_rights() -> dict[str, Rights]:
    """The rights of each role, from the file that comes with nuno."""
    table = yaml.safe_load((deploy_folder() / "access.yaml").read_text(encoding="utf-8"))
    return {role: Rights.model_validate(rights) for role, rights in table.items()}


def access_control(roles: dict[str, Rights]) -> dict[str, Any]:
    """The `access_control` section of a router's zenoh configuration; what is not allowed is denied.

    Everybody is told which subscribers and queryables there are, without which a publisher would send nothing.
    """
    shared = [
        *_rules("who listens", [("declare_subscriber", OUT), ("declare_queryable", OUT)], ["**"]),
        *_rules("who is alive", ALIVE, ["alive/*"]),
    ]
    rules, policies = list(shared), []
    for role, rights in roles.items():
        own = [
            rule
            for right, kinds in RIGHTS.items()
            if (topics := getattr(rights, right))
            for rule in _rules(f"{role} {right}", kinds, topics)
        ]
        if role not in PEOPLE:
            own += _rules(f"{role} is alive", [("liveliness_token", IN)], [f"alive/{role}"])
        rules += own
        policies.append({"id": role, "rules": [rule["id"] for rule in (*shared, *own)], "subjects": [role]})
    subjects = [{"id": role, "cert_common_names": [role]} for role in roles]
    tables = {"rules": rules, "subjects": subjects, "policies": policies}
    return {"enabled": True, "default_permission": "deny"} | tables


def _rules(name: str, kinds: Sequence[tuple[str, str]], topics: Sequence[str]) -> list[dict[str, Any]]:
    """One rule for each direction in which there is something to allow."""
    keys = [f"nuno/*/{topic}" for topic in topics]
    return [
        {"id": f"{name}: {flow}", "permission": "allow", "flows": [flow], "messages": messages, "key_exprs": keys}
        for flow in (IN, OUT)
        if (messages := [message for message, direction in kinds if direction == flow])
    ]
