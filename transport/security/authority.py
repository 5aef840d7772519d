"""Private certificate authority, and certificates that it signs, as PEM texts."""

from __future__ import annotations

import datetime
import ipaddress
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from transport.exceptions import SecurityError, errors_as

T = TypeVar("T")

# Lifetime of a CA [days]. A CA is never renewed; it is replaced together with the whole security folder.
AUTHORITY_DAYS = 3650

# Lifetime of a member's certificate [days]. Some TLS clients reject server certificates with a longer lifetime.
CERTIFICATE_DAYS = 825


@dataclass(frozen=True, slots=True)
class Credentials:
    """Certificate and its private key.

    Attributes:
        certificate: PEM text.
        key: PEM text, not encrypted; store it so that only its owner can read it.
    """

    certificate: bytes
    key: bytes


def _signed(
    common_name: str,
    days: int,
    extensions: Sequence[tuple[Any, bool]],
    issuer: Any = None,
    signer: Any = None,
) -> Credentials:
    """Make a P-256 key and its certificate, which is self-signed unless issuer and signer are given.

    Args:
        common_name: name of the owner.
        days: lifetime from now [days].
        extensions: X.509 extensions, each with True if it is critical.
        issuer: subject of the CA that signs the certificate.
        signer: private key of that CA.
    """
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec
    from cryptography.x509.oid import NameOID

    key = ec.generate_private_key(ec.SECP256R1())
    now = datetime.datetime.now(datetime.UTC)
    end = now + datetime.timedelta(days=days)
    # Start the validity one hour in the past, so that a robot whose clock is slow accepts the certificate.
    begin = min(now, end) - datetime.timedelta(hours=1)
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common_name)])
    builder = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(issuer or name)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(begin)
        .not_valid_after(end)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
    )
    for extension, is_critical in extensions:
        builder = builder.add_extension(extension, critical=is_critical)
    pem, without = serialization.Encoding.PEM, serialization.NoEncryption()
    certificate = builder.sign(signer or key, hashes.SHA256()).public_bytes(pem)
    return Credentials(certificate, key.private_bytes(pem, serialization.PrivateFormat.PKCS8, without))


def read_certificate(path: Path, take: Callable[[Any], T]) -> T:
    """Read a certificate file, and return what `take` extracts from the certificate.

    Raises:
        SecurityError: the file cannot be read, or lacks what `take` extracts.
    """
    from cryptography import x509

    with errors_as(SecurityError, f"cannot read {path}", OSError, ValueError, LookupError, x509.ExtensionNotFound):
        return take(x509.load_pem_x509_certificate(path.read_bytes()))


def make_authority(common_name: str) -> Credentials:
    """Make a self-signed P-256 CA that may sign only end-entity certificates and revocation lists."""
    from cryptography import x509

    others = ("digital_signature", "content_commitment", "key_encipherment", "data_encipherment", "key_agreement")
    unused = dict.fromkeys((*others, "encipher_only", "decipher_only"), False)
    usage = x509.KeyUsage(key_cert_sign=True, crl_sign=True, **unused)
    return _signed(common_name, AUTHORITY_DAYS, [(x509.BasicConstraints(ca=True, path_length=0), True), (usage, True)])


def make_certificate(
    authority: Credentials, common_name: str, hosts: Sequence[str], *, days: int = CERTIFICATE_DAYS
) -> Credentials:
    """Make a certificate for both ends of TLS connections, signed by `authority`.

    Args:
        authority: certificate and key of the CA.
        common_name: name of the owner, such as `<robot>.<role>`, by which the access rules identify it.
        hosts: host names and addresses of the owner.
        days: lifetime from now [days]; a negative value makes an expired certificate.
    """
    from cryptography import x509
    from cryptography.hazmat.primitives.serialization import load_pem_private_key
    from cryptography.x509.oid import ExtendedKeyUsageOID

    signer: Any = load_pem_private_key(authority.key, password=None)
    names: list[x509.GeneralName] = []
    for host in hosts:
        try:
            names.append(x509.IPAddress(ipaddress.ip_address(host)))
        except ValueError:
            names.append(x509.DNSName(host))
    uses = [ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]
    extensions = [
        (x509.BasicConstraints(ca=False, path_length=None), True),
        (x509.SubjectAlternativeName(names), False),
        (x509.ExtendedKeyUsage(uses), False),
        (x509.AuthorityKeyIdentifier.from_issuer_public_key(signer.public_key()), False),
    ]
    parent = x509.load_pem_x509_certificate(authority.certificate).subject
    return _signed(common_name, days, extensions, parent, signer)
