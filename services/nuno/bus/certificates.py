"""A certificate authority of one deployment, and certificates that it signs (X.509 v3, RFC 5280).

Keys are on the curve P-256, which all TLS 1.3 peers support. Only the router's certificate is for servers: with
that of a role nobody can pose as the router, though the same authority signed it. A role is the common name.
"""

from __future__ import annotations

import datetime
import ipaddress
from dataclasses import dataclass

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, load_pem_private_key
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from nuno_schemas.errors import BadInput

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


def make_authority(name: str = "nuno") -> Pair:
    """Make an authority that may only sign certificates."""
    return _make(f"{name} {AUTHORITY}", None, AUTHORITY_DAYS, ())


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
