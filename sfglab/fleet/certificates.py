"""Certificates, keys and access control of a fleet over Zenoh, in one folder.

Hubs and agents need the certificate of the authority, and a certificate and key of their own; hubs also need the
access control. The key of the authority stays with the person who manages the fleet. The module needs the extra
``zenoh``.
"""

from __future__ import annotations

import ipaddress
import json
import re
from datetime import UTC, datetime, timedelta
from itertools import chain, count
from secrets import token_hex
from typing import TYPE_CHECKING, Any

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric.ec import SECP256R1, generate_private_key
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    load_pem_private_key,
)
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from sfglab.bus.zenoh.security import ACCESS, AUTHORITY
from sfglab.errors import InvalidValueError
from sfglab.files import read_text, write_files
from sfglab.fleet.access_control import HUB, access_control

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from sfglab.fleet.fleet_file import Fleet

#: Validity of the certificates of the authority, and of hubs and agents, days.
AUTHORITY_DAYS, DAYS = 3650, 825
_EARLIER = timedelta(days=1)  # a robot's clock may be slow
_SIGNS = x509.BasicConstraints(ca=True, path_length=0)
# A session connects, and a hub or peer also accepts connections.
_ROLES = x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH])


def write_certificates(
    fleet: Fleet, folder: Path, hubs: Iterable[Sequence[str]] = ()
) -> list[tuple[str, str, str]]:
    """Write the missing certificates and keys of a fleet into a folder, and the access control of its policy.

    Existing certificates and keys are kept; only the access control is replaced.

    Args:
        fleet: The fleet.
        folder: Folder of the files.
        hubs: For each hub, the names and addresses to which agents connect. The files of the first are called
            ``hub``, those of the second ``hub2``.

    Returns:
        For each certificate its file, "new" or "kept", and the day on which it expires, YYYY-MM-DD in UTC; in the last
        row the file of the access control.

    Raises:
        InvalidValueError: A name is not allowed, a file cannot be read or written, an existing certificate belongs
            to another authority or has other names, or the policy cannot be expressed.
        ValueError: An existing certificate or key is damaged.
    """
    folder = folder.absolute()
    files = {folder / ACCESS: json.dumps(access_control(fleet), indent=1) + "\n"}
    path = folder / AUTHORITY
    if path.exists():
        authority = _read(path)
        text = read_text(path.with_suffix(".key"), "the key of the authority")
        signer = load_pem_private_key(text.encode(), None)
    else:
        signer = generate_private_key(SECP256R1())
        # Authorities have different names, so that a certificate tells which of them issued it.
        authority = _issue(f"fleet authority {token_hex(8)}", None, signer, signer, [_SIGNS])
        files |= _files(path, authority, signer)
    members: list[tuple[str, str, list[Any]]] = [
        (f"hub{number}", HUB, [x509.SubjectAlternativeName(map(_general_name, names))])
        for number, names in zip(chain([""], count(2)), hubs, strict=False)
    ]
    members += [(agent.name, agent.name, []) for agent in fleet.agents]
    certificates = {path: authority}
    for name, common_name, extensions in members:
        path = folder / f"{name}.pem"
        if path in certificates:
            raise InvalidValueError("agent", name, "a name that no hub and no authority has")
        if path.exists():
            certificate = _read(path)
            held = {extension.value for extension in certificate.extensions}
            if certificate.issuer != authority.subject or not held.issuperset(extensions):
                allowed = "one of this authority with these names; delete it to replace it"
                raise InvalidValueError(path, "another certificate", allowed)
        else:
            key = generate_private_key(SECP256R1())
            certificate = _issue(common_name, authority.subject, key, signer, [_ROLES, *extensions])
            files |= _files(path, certificate, key)
        certificates[path] = certificate
    modes = {path: 0o600 for path in files if path.suffix == ".key"}
    write_files(files, folder=folder, modes=modes)
    rows = [
        (path.name, "new" if path in files else "kept", f"{each.not_valid_after_utc:%Y-%m-%d}")
        for path, each in certificates.items()
    ]
    return [*rows, (ACCESS, "written", "")]


def _read(path: Path) -> x509.Certificate:
    return x509.load_pem_x509_certificate(read_text(path).encode())


def _issue(
    common_name: str, issuer: x509.Name | None, key: Any, signer: Any, extensions: Iterable[Any]
) -> x509.Certificate:
    """Return a certificate of a key; without an issuer, that of a new authority."""
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common_name)])
    now = datetime.now(UTC)
    builder = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer or subject)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - _EARLIER)
        .not_valid_after(now + timedelta(days=DAYS if issuer else AUTHORITY_DAYS))
    )
    for extension in extensions:
        builder = builder.add_extension(extension, critical=extension is _SIGNS)
    return builder.sign(signer, SHA256())


def _files(path: Path, certificate: x509.Certificate, key: Any) -> dict[Path, str]:
    """Return the files of a certificate and its key."""
    key_path = path.with_suffix(".key")
    if key_path.exists():
        raise InvalidValueError(key_path, "a key", "none without a certificate; delete it")
    form = (Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    return {
        path: certificate.public_bytes(Encoding.PEM).decode(),
        key_path: key.private_bytes(*form).decode(),
    }


def _general_name(name: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(name))
    except ValueError:
        if not re.fullmatch(r"\w[\w.-]*", name, re.ASCII):
            allowed = "names and addresses of a host, without a port"
            raise InvalidValueError("hub", name, allowed) from None
        return x509.DNSName(name)
