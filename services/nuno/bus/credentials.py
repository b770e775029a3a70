"""A folder of certificates: one zenoh configuration per role, complete in itself, and the authority that signed them.

A role's file has its certificate, its key, and the authority's certificate: it is all that a host needs of this
folder, and nothing that another role could use. The authority's key never leaves the machine where it was made.
"""

from __future__ import annotations

import base64
import datetime
import ipaddress
import json
import os
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import yaml
from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, load_pem_private_key
from cryptography.x509 import load_pem_x509_certificate
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID
from pydantic import BaseModel, ConfigDict

from nuno_schemas.errors import BadInput, nearest

# A certificate authority of one deployment, and certificates that it signs (X.509 v3, RFC 5280).
#
# Keys are on the curve P-256, which all TLS 1.3 peers support. Only the router's certificate is for servers: with
# that of a role nobody can pose as the router, though the same authority signed it. A role is the common name.

ROUTER, AUTHORITY = "router", "authority"
AUTHORITY_DAYS = 3650
SKEW = datetime.timedelta(hours=1)
"""Tolerance for the clocks of hosts: a certificate is valid from this time before its creation."""


@dataclass(frozen=True)
class Pair:
    """A certificate and its private key."""

    certificate: x509.Certificate
    key: ec.EllipticCurvePrivateKey

    @property
    def certificate_pem(self) -> bytes:
        return self.certificate.public_bytes(Encoding.PEM)

    @property
    def key_pem(self) -> bytes:
        """The key in PKCS 8, not encrypted: the file's mode protects it."""
        return self.key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())


def now() -> datetime.datetime:
    return datetime.datetime.now(datetime.UTC)


def sign(authority: Pair, role: str, days: float, hosts: tuple[str, ...] = ()) -> Pair:
    """Make a certificate of one role. `hosts` are the names and addresses of the router.

    Raises BadInput for a host that is neither.
    """
    return _make(role, authority, days, hosts if role == ROUTER else (role,))


def _make(name: str, authority: Pair | None, days: float, hosts: tuple[str, ...]) -> Pair:
    key = ec.generate_private_key(ec.SECP256R1())
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    begin, end = now() - SKEW, now() + datetime.timedelta(days=days)
    builder = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(authority.certificate.subject if authority else subject)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(min(begin, end - SKEW))
        .not_valid_after(end)
        .add_extension(x509.BasicConstraints(ca=authority is None, path_length=None if authority else 0), critical=True)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
        .add_extension(_usage(signs=authority is None), critical=True)
    )
    if authority is not None:
        serves = ExtendedKeyUsageOID.SERVER_AUTH if name == ROUTER else ExtendedKeyUsageOID.CLIENT_AUTH
        issuer = x509.AuthorityKeyIdentifier.from_issuer_public_key(authority.key.public_key())
        builder = (
            builder.add_extension(x509.ExtendedKeyUsage([serves]), critical=True)
            .add_extension(x509.SubjectAlternativeName([host_name(host) for host in hosts]), critical=False)
            .add_extension(issuer, critical=False)
        )
    return Pair(builder.sign(authority.key if authority else key, SHA256()), key)


def _usage(signs: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not signs, content_commitment=False, key_encipherment=False, data_encipherment=False,
        key_agreement=False, key_cert_sign=signs, crl_sign=signs, encipher_only=False, decipher_only=False,
    )  # fmt: skip


def host_name(host: str) -> x509.GeneralName:
    """Return a name or an address for a certificate. Raises BadInput for neither."""
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        pass
    try:
        if not host or not all(part.replace("-", "").isalnum() for part in host.split(".")):
            raise ValueError
        return x509.DNSName(host)
    except ValueError:
        remedy = "give names or addresses by which hosts reach the router, separated by commas"
        raise BadInput("neither a host's name nor an address", field="--hosts", value=host, remedy=remedy) from None


def load(certificate: bytes, key: bytes) -> Pair:
    """Load a pair from PEM. Raises ValueError for invalid PEM, or a key of another certificate."""
    loaded, private = x509.load_pem_x509_certificate(certificate), load_pem_private_key(key, None)
    if not isinstance(private, ec.EllipticCurvePrivateKey) or private.public_key() != loaded.public_key():
        raise ValueError("the key does not belong to the certificate")
    return Pair(loaded, private)


def name_of(certificate: x509.Certificate) -> str:
    """Return the common name, which is the role."""
    names = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    return str(names[0].value) if names else ""


def hosts_of(certificate: x509.Certificate) -> list[str]:
    """Return the names and addresses of a certificate."""
    names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    return [str(name.value) for name in names]


# The rights of roles, from deploy/access.yaml to zenoh's access control, which a router enforces.
#
# zenoh names nine kinds of messages and two directions, seen from the router: what comes in from a client (ingress) and
# what goes out to it (egress). Each right needs several of them: a reader of a topic declares a subscriber and receives
# puts; a client sends a query and receives the reply; a queryable is declared, receives the query and replies. A role
# is the common name of a client's certificate, so nobody can take another's.
#
# A wildcard is matched by inclusion: the right to publish `sim/state` of every run does not include `**`.

IN, OUT = "ingress", "egress"
RIGHTS: dict[str, tuple[tuple[str, str], ...]] = {
    "publishes": (("put", IN),),
    "reads": (("declare_subscriber", IN), ("put", OUT)),
    "answers": (("declare_queryable", IN), ("query", OUT), ("reply", IN)),
    "asks": (("query", IN), ("reply", OUT)),
}
"""Messages and directions of each right."""
ALIVE = (("declare_liveliness_subscriber", IN), ("liveliness_query", IN), ("liveliness_token", OUT))
"""Messages and directions of liveliness, for later and present tokens."""
PEOPLE = ("operator", "observer")
"""Roles that are not services of a run."""


class Rights(BaseModel):
    """Rights of one role: topics below `nuno/RUN/`, as key expressions."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    publishes: tuple[str, ...] = ()
    reads: tuple[str, ...] = ()
    answers: tuple[str, ...] = ()
    asks: tuple[str, ...] = ()


def read_rights() -> dict[str, Rights]:
    """Read the rights of each role, from the file that comes with nuno."""
    source = Path(__file__).resolve().parents[3]
    folder = source if (source / "deploy").is_dir() else Path(str(files("nuno")))  # else the installed package
    table = yaml.safe_load((folder / "deploy/access.yaml").read_text(encoding="utf-8"))
    return {role: Rights.model_validate(rights) for role, rights in table.items()}


def access_control(roles: dict[str, Rights]) -> dict[str, Any]:
    """Return the `access_control` section of a router's zenoh configuration, which denies by default.

    All roles receive the declarations of subscribers and queryables, without which a publisher would send nothing.
    """
    shared = [
        *_rules("who listens", [("declare_subscriber", OUT), ("declare_queryable", OUT)], ["**"]),
        *_rules("who is alive", ALIVE, ["alive/*"]),
    ]
    rules, policies = list(shared), []
    for role, rights in roles.items():
        role_rules = [
            rule
            for right, kinds in RIGHTS.items()
            if (topics := getattr(rights, right))
            for rule in _rules(f"{role} {right}", kinds, topics)
        ]
        if role not in PEOPLE:
            role_rules += _rules(f"{role} is alive", [("liveliness_token", IN)], [f"alive/{role}"])
        rules += role_rules
        policies.append({"id": role, "rules": [rule["id"] for rule in (*shared, *role_rules)], "subjects": [role]})
    subjects = [{"id": role, "cert_common_names": [role]} for role in roles]
    tables = {"rules": rules, "subjects": subjects, "policies": policies}
    return {"enabled": True, "default_permission": "deny"} | tables


def _rules(name: str, kinds: Sequence[tuple[str, str]], topics: Sequence[str]) -> list[dict[str, Any]]:
    """Return one rule for each direction with allowed messages."""
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
"""Purpose of each file that is not for the service of its name."""
MOST_DAYS = 825
"""Longest validity that platforms commonly accept, except for authorities [days]."""


@dataclass(frozen=True)
class Kept:
    """A certificate in the folder."""

    role: str
    path: Path
    ends: datetime.datetime
    hosts: tuple[str, ...]
    wrong: str = ""
    """The problem of the certificate, empty without one."""

    @property
    def purpose(self) -> str:
        return PURPOSES.get(self.role, f"nuno serve {self.role}")


def roles() -> list[str]:
    """Return all roles, the router first."""
    return [ROUTER, *read_rights()]


def make(folder: Path, hosts: tuple[str, ...], wanted: list[str], days: int) -> list[Kept]:
    """Make certificates, with the authority in the folder or a new one.

    Raises BadInput for an unknown role, before anything is written for a file that exists, and for a folder that
    cannot be written.
    """
    known_roles = roles()
    for role in wanted:
        if role not in known_roles:
            raise BadInput("no such role", field="--roles", value=role, remedy=nearest(role, known_roles))
    for host in hosts:
        host_name(host)
    if not 1 <= days <= MOST_DAYS:
        raise BadInput("a certificate holds for 1 day or more", "--days", value=days, limit=f"at most {MOST_DAYS}")
    for role in wanted:
        if _path(folder, role).exists():
            remedy = "move it away first, or name other roles: --roles"
            raise BadInput("this would be overwritten", value=str(_path(folder, role)), remedy=remedy)
    existing = set[Path]()
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        folder.chmod(0o700)
        existing = set(folder.iterdir())
        authority = _authority(folder)
        pairs = {role: sign(authority, role, days, hosts) for role in wanted}
        for role, pair in pairs.items():
            _write(_path(folder, role), configuration(role, pair, authority))
    except OSError as error:
        for path in set(folder.glob("*")) - existing:  # incomplete files, or an authority without its key
            path.unlink()
        remedy = "name a folder of your own"
        raise BadInput(f"cannot be written: {error.strerror}", value=str(folder), remedy=remedy) from None
    return [_kept(folder, role, pair) for role, pair in pairs.items()]


def check(folder: Path) -> list[Kept]:
    """Return the certificates of a folder, with their problems. Raises BadInput where there is no authority."""
    authority = _authority_paths(folder)[0]
    if not authority.is_file():
        remedy = f"make certificates: nuno certs {folder}"
        raise BadInput("there are no certificates here", value=str(folder), remedy=remedy)
    trusted = authority.read_bytes()
    return [_check(folder, role, trusted) for role in roles() if _path(folder, role).exists()]


def _check(folder: Path, role: str, trusted: bytes) -> Kept:
    path, wrong = _path(folder, role), ""
    try:
        certificate, signer, key = _read(path, role)
        pair = load(certificate, key)
        authority = load_pem_x509_certificate(trusted)
        pair.certificate.verify_directly_issued_by(authority)
        if signer != trusted or name_of(pair.certificate) != role:
            raise ValueError("it is another role's, or another authority's")
    except (OSError, ValueError, KeyError, TypeError, InvalidSignature) as error:
        text = str(error) or "another authority signed it"
        return Kept(role, path, now(), (), f"cannot be used: {text}; move it away and make it again")
    if pair.certificate.not_valid_after_utc < now():
        wrong = "it has expired: move it away and make it again"
    elif path.stat().st_mode & 0o077:
        wrong = f"others can read its key: chmod 600 {path}"
    kept = _kept(folder, role, pair)
    return Kept(role, path, kept.ends, kept.hosts, wrong)


def _authority_paths(folder: Path) -> tuple[Path, Path]:
    return folder / f"{AUTHORITY}.pem", folder / f"{AUTHORITY}.key"


def _authority(folder: Path) -> Pair:
    """Return the folder's authority, a new one if there is none. Raises BadInput where it is damaged."""
    certificate, key = _authority_paths(folder)
    if not certificate.exists() and not key.exists():
        pair = _make(f"nuno {AUTHORITY}", None, AUTHORITY_DAYS, ())  # which may only sign certificates
        _write(key, pair.key_pem)
        _write(certificate, pair.certificate_pem)
        return pair
    try:
        return load(certificate.read_bytes(), key.read_bytes())
    except (OSError, ValueError) as error:
        remedy = "begin anew in an empty folder; hosts then need all files again"
        raise BadInput(f"the authority cannot be used: {error}", value=str(folder), remedy=remedy) from None


def _path(folder: Path, role: str) -> Path:
    return folder / f"{role}.json5"


def _write(path: Path, content: bytes) -> None:
    """Create a file that only its owner can ever read."""
    with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
        file.write(content)


def configuration(role: str, pair: Pair, authority: Pair) -> bytes:
    """Return the zenoh configuration of a role, with the certificates in it: paths would differ between hosts."""
    side = _side(role)
    tls = {
        "root_ca_certificate_base64": _text(authority.certificate_pem),
        f"{side}_certificate_base64": _text(pair.certificate_pem),
        f"{side}_private_key_base64": _text(pair.key_pem),
        "enable_mtls": True,
    }
    if role != ROUTER:
        tls["verify_name_on_connect"] = True
    # Hosts share no memory; and on one host, shared memory would bypass the access control.
    transport = {"link": {"protocols": ["tls"], "tls": tls}, "shared_memory": {"enabled": False}}
    config: dict[str, Any] = {"transport": transport}
    if role == ROUTER:
        config["access_control"] = access_control(read_rights())
    return json.dumps(config, indent=1).encode() + b"\n"


def _read(path: Path, role: str) -> tuple[bytes, bytes, bytes]:
    """Read a file's certificate, its authority's, and its key, as PEM."""
    tls, side = json.loads(path.read_bytes())["transport"]["link"]["tls"], _side(role)
    names = (f"{side}_certificate_base64", "root_ca_certificate_base64", f"{side}_private_key_base64")
    certificate, authority, key = (base64.b64decode(tls[name], validate=True) for name in names)
    return certificate, authority, key


def role_of(config: Path) -> str:
    """Return the common name in a client's configuration by `nuno certs`; "" for any other file."""
    with suppress(OSError, ValueError, KeyError, TypeError):
        return name_of(load_pem_x509_certificate(_read(config, "")[0]))
    return ""


def _side(role: str) -> str:
    return "listen" if role == ROUTER else "connect"


def _text(content: bytes) -> str:
    return base64.b64encode(content).decode()


def _kept(folder: Path, role: str, pair: Pair) -> Kept:
    hosts = tuple(hosts_of(pair.certificate)) if role == ROUTER else ()
    return Kept(role, _path(folder, role), pair.certificate.not_valid_after_utc, hosts)
