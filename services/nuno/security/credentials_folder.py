"""A folder of certificates: one zenoh configuration per role, complete in itself, and the authority that signed them.

A role's file holds its certificate, its key, and the authority's certificate: it is all that a host needs of this
folder, and nothing that another role could use. The authority's key never leaves the machine where it was made.
"""

from __future__ import annotations

import base64
import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from importlib.resources import files
from pathlib import Path
from typing import Any

import yaml
from cryptography.exceptions import InvalidSignature
from cryptography.x509 import load_pem_x509_certificate
from pydantic import BaseModel, ConfigDict

from nuno.security import certificates
from nuno.security.certificates import AUTHORITY, ROUTER, Pair
from nuno_schemas.errors import BadInput, nearest

# The rights of roles, from deploy/access.yaml to zenoh's access control, which a router enforces.
#
# zenoh names nine kinds of messages and two directions, seen from the router: what comes in from a client (ingress) and
# what goes out to it (egress). Each right needs several of them: who reads a topic declares a subscriber and is sent
# what is put; who asks sends a query and is sent the reply; who answers declares a queryable, is sent the query and
# replies. A role is the common name of a client's certificate, so nobody takes another one's.
#
# A wildcard is matched by inclusion: who may publish `sim/state` of every run cannot publish `**`, nor subscribe to it.

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


PURPOSES = {
    ROUTER: "nuno serve router, or a run that listens",
    "supervisor": "nuno run --connect",
    "operator": "nuno control and nuno draw: reads, and may change a run",
    "observer": "reads, and changes nothing",
}
"""What each file is for, where that is not the service of its name."""
MOST_DAYS = 825
"""What platforms commonly accept of a certificate that is not an authority's."""


@dataclass(frozen=True)
class Kept:
    """A certificate in the folder."""

    role: str
    path: Path
    ends: datetime
    hosts: tuple[str, ...]
    wrong: str = ""
    """What is amiss, empty where nothing is."""

    @property
    def purpose(self) -> str:
        return PURPOSES.get(self.role, f"nuno serve {self.role}")


def roles() -> list[str]:
    """Every role there is, the router first."""
    return [ROUTER, *read_rights()]


def make(folder: Path, hosts: tuple[str, ...], wanted: list[str], days: int) -> list[Kept]:
    """Make certificates, with the authority that lies in the folder or a new one.

    Raises BadInput for an unknown role, before anything is written for a file that exists, and for a folder that
    cannot be written.
    """
    known = roles()
    for role in wanted:
        if role not in known:
            raise BadInput("no such role", field="--roles", value=role, remedy=nearest(role, known))
    for host in hosts:
        certificates.host_name(host)
    if not 1 <= days <= MOST_DAYS:
        raise BadInput("a certificate holds for 1 day or more", "--days", value=days, limit=f"at most {MOST_DAYS}")
    for role in wanted:
        if _path(folder, role).exists():
            remedy = "move it away first, or name other roles: --roles"
            raise BadInput("this would be overwritten", value=str(_path(folder, role)), remedy=remedy)
    before = set[Path]()
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        folder.chmod(0o700)
        before = set(folder.iterdir())
        authority = _authority(folder)
        pairs = {role: certificates.sign(authority, role, days, hosts) for role in wanted}
        for role, pair in pairs.items():
            _write(_path(folder, role), configuration(role, pair, authority))
    except OSError as error:
        for path in set(folder.glob("*")) - before:  # a part of a file, or an authority without its key
            path.unlink()
        remedy = "name a folder of your own"
        raise BadInput(f"cannot be written: {error.strerror}", value=str(folder), remedy=remedy) from None
    return [_kept(folder, role, pair) for role, pair in pairs.items()]


def check(folder: Path) -> list[Kept]:
    """What the folder holds, and what is wrong with it. Raises BadInput where there is no authority."""
    authority = _authority_paths(folder)[0]
    if not authority.is_file():
        remedy = f"make certificates: nuno certs {folder}"
        raise BadInput("there are no certificates here", value=str(folder), remedy=remedy)
    trusted = authority.read_bytes()
    return [_check(folder, role, trusted) for role in roles() if _path(folder, role).exists()]


def _check(folder: Path, role: str, trusted: bytes) -> Kept:
    path, wrong = _path(folder, role), ""
    try:
        own, signer, key = _read(path, role)
        pair = certificates.load(own, key)
        authority = load_pem_x509_certificate(trusted)
        pair.certificate.verify_directly_issued_by(authority)
        if signer != trusted or certificates.name_of(pair.certificate) != role:
            raise ValueError("it is another role's, or another authority's")
    except (OSError, ValueError, KeyError, TypeError, InvalidSignature) as error:
        text = str(error) or "another authority signed it"
        return Kept(role, path, certificates.now(), (), f"cannot be used: {text}; move it away and make it again")
    if pair.certificate.not_valid_after_utc < certificates.now():
        wrong = "it has expired: move it away and make it again"
    elif path.stat().st_mode & 0o077:
        wrong = f"others can read its key: chmod 600 {path}"
    kept = _kept(folder, role, pair)
    return Kept(role, path, kept.ends, kept.hosts, wrong)


def _authority_paths(folder: Path) -> tuple[Path, Path]:
    return folder / f"{AUTHORITY}.pem", folder / f"{AUTHORITY}.key"


def _authority(folder: Path) -> Pair:
    """The folder's, made if there is none. Raises BadInput where it is damaged."""
    certificate, key = _authority_paths(folder)
    if not certificate.exists() and not key.exists():
        pair = certificates.make_authority()
        _write(key, pair.key_pem)
        _write(certificate, pair.certificate_pem)
        return pair
    try:
        return certificates.load(certificate.read_bytes(), key.read_bytes())
    except (OSError, ValueError) as error:
        remedy = "begin anew in an empty folder; hosts then need all files again"
        raise BadInput(f"the authority cannot be used: {error}", value=str(folder), remedy=remedy) from None


def _path(folder: Path, role: str) -> Path:
    return folder / f"{role}.json5"


def _write(path: Path, content: bytes) -> None:
    """Create a file that only its owner can read, from its first byte on."""
    with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
        file.write(content)


def configuration(role: str, pair: Pair, authority: Pair) -> bytes:
    """The zenoh configuration of a role, with everything in it: paths would have to hold on every host."""
    side = _side(role)
    tls = {
        "root_ca_certificate_base64": _text(authority.certificate_pem),
        f"{side}_certificate_base64": _text(pair.certificate_pem),
        f"{side}_private_key_base64": _text(pair.key_pem),
        "enable_mtls": True,
    }
    if role != ROUTER:
        tls["verify_name_on_connect"] = True
    # Between hosts nothing is shared; and on one host, nothing should be read past the access control.
    transport = {"link": {"protocols": ["tls"], "tls": tls}, "shared_memory": {"enabled": False}}
    config: dict[str, Any] = {"transport": transport}
    if role == ROUTER:
        config["access_control"] = access_control(read_rights())
    return json.dumps(config, indent=1).encode() + b"\n"


def _read(path: Path, role: str) -> tuple[bytes, bytes, bytes]:
    """A file's certificate, its authority's, and its key, as PEM."""
    tls, side = json.loads(path.read_bytes())["transport"]["link"]["tls"], _side(role)
    names = (f"{side}_certificate_base64", "root_ca_certificate_base64", f"{side}_private_key_base64")
    own, authority, key = (base64.b64decode(tls[name], validate=True) for name in names)
    return own, authority, key


def _side(role: str) -> str:
    return "listen" if role == ROUTER else "connect"


def _text(content: bytes) -> str:
    return base64.b64encode(content).decode()


def _kept(folder: Path, role: str, pair: Pair) -> Kept:
    hosts = tuple(certificates.hosts_of(pair.certificate)) if role == ROUTER else ()
    return Kept(role, _path(folder, role), pair.certificate.not_valid_after_utc, hosts)
