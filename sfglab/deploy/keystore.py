"""A fleet's keystore for DDS Security, laid out as ROS 2's `sros2` does.

``private/`` has the key that signs, which stays where it is made; ``enclaves/<agent>`` what the agent needs.
Keys, certificates and signatures are the library `cryptography`'s: P-256, X.509, S/MIME (OMG DDS Security 1.1,
9.3.1 and 9.4.1). What exists is kept. Refuses to know who may do what (`sfglab.deploy.permissions`).
"""

from __future__ import annotations

import os
import shutil
import tempfile
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime, timedelta
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

from sfglab.deploy.errors import DeployError, MissingProgramError
from sfglab.deploy.files import render
from sfglab.deploy.permissions import LAST_DOMAIN, render_permissions
from sfglab.errors import why

try:
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes
    from cryptography.hazmat.primitives import serialization as pem
    from cryptography.hazmat.primitives.asymmetric import ec
    from cryptography.hazmat.primitives.serialization import pkcs7
except ImportError as error:
    raise MissingProgramError("cryptography") from error

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator

    from sfglab.fleet.fleet_file import Fleet

    _Times: TypeAlias = tuple[datetime, datetime]  # from when, until when
    _Authority: TypeAlias = tuple[ec.EllipticCurvePrivateKey, x509.Certificate]

CA_DAYS = 3650  #: How long what signs is valid, as `sros2` has it.
_PEM = pem.Encoding.PEM
_LAG = timedelta(days=1)  # A robot's clock may be late when it starts.
_LOAD_KEY, _LOAD_CERT = (
    partial(pem.load_pem_private_key, password=None),
    x509.load_pem_x509_certificate,
)
_LINKED = (
    "../../public/identity_ca.cert.pem",
    "../../public/permissions_ca.cert.pem",
    "../governance.p7s",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Enclave:
    """An agent's part of a keystore."""

    agent: str  #: Whose.
    state: Literal["new", "renewed", "kept", "outdated", "expired"]  #: Outdated: others are due.
    not_after: datetime  #: Until when certificate and permissions are valid.


def make_keystore(
    fleet: Fleet, root: Path, *, now: datetime, days: int = 365, renew: Collection[str] = ()
) -> tuple[Enclave, ...]:
    """Make a fleet's keystore in a folder, or add to it the agents that it lacks; what it has is kept.

    Certificates and permissions are valid for some days from `now`, which has its zone, at most as long as what
    signs them. Agents of `renew` get new ones, for the key that they have.

    Raises:
        DeployError: The folder is something else, or has not what signs, or cannot be written.
        InvalidValueError: The fleet has no such agent, or a domain cannot be secured.
    """
    again = [fleet.agent(name) for name in renew]
    try:
        if not root.exists() or not any(root.iterdir()):
            _create(root, (now - _LAG, now + timedelta(days=CA_DAYS)))
        key = _read(root / "private/ca.key.pem", _LOAD_KEY)
        cert = _read(root / "public/ca.cert.pem", _LOAD_CERT)
        if key.public_key() != cert.public_key():
            raise DeployError(
                f"{root}: given another private/ca.key.pem, allowed: that of public/ca.cert.pem"
            )
        valid = now - _LAG, min(now + timedelta(days=days), cert.not_valid_after_utc)
        enclaves = []
        for agent in fleet.agents:
            folder = root / "enclaves" / agent.name
            kept = folder.exists() and agent not in again
            enclaves.append(
                _judge(fleet, folder, now) if kept else _issue(fleet, folder, (key, cert), valid)
            )
        return tuple(enclaves)
    except OSError as error:
        given = f"{error.filename or root}: {why(error)}"
        raise DeployError(f"{given}, allowed: a whole keystore to write") from error


def _create(root: Path, valid: _Times) -> None:
    """Make a keystore without agents."""
    key = ec.generate_private_key(ec.SECP256R1())
    cert = _certificate("sros2CA", key, valid, None)
    governance = render("security/governance.xml", last_domain=LAST_DOMAIN)
    with _staged(root) as stage:
        _write(stage / "enclaves/governance.xml", governance.encode())
        _write(stage / "enclaves/governance.p7s", _signed(governance, (key, cert)))
        for place, content in (
            ("private/{}ca.key.pem", _pem(key)),
            ("public/{}ca.cert.pem", cert.public_bytes(_PEM)),
        ):
            _write(stage / place.format(""), content)
            for role in ("identity_", "permissions_"):
                (stage / place.format(role)).symlink_to(Path(place.format("")).name)


def _issue(fleet: Fleet, folder: Path, authority: _Authority, valid: _Times) -> Enclave:
    """Make an agent's enclave; one that is there keeps its key."""
    renewed, agent = folder.exists(), folder.name
    key = (
        _read(folder / "key.pem", _LOAD_KEY) if renewed else ec.generate_private_key(ec.SECP256R1())
    )
    permissions = render_permissions(fleet, agent, *valid)
    with _staged(folder) as stage:
        _write(stage / "key.pem", _pem(key))
        _write(
            stage / "cert.pem", _certificate(f"/{agent}", key, valid, authority).public_bytes(_PEM)
        )
        _write(stage / "permissions.xml", permissions.encode())
        _write(stage / "permissions.p7s", _signed(permissions, authority))
        _write(stage / "cyclonedds.xml", render("security/cyclonedds.xml.j2", agent=agent).encode())
        for target in map(Path, _LINKED):
            (stage / target.name).symlink_to(target)
    return Enclave(agent=agent, state="renewed" if renewed else "new", not_after=valid[1])


def _judge(fleet: Fleet, folder: Path, now: datetime) -> Enclave:
    """Say how an enclave stands that is kept."""
    cert = _read(folder / "cert.pem", _LOAD_CERT)
    valid = cert.not_valid_before_utc, cert.not_valid_after_utc
    same = (folder / "permissions.xml").read_text("utf-8") == render_permissions(
        fleet, folder.name, *valid
    )
    state: Any = "expired" if valid[1] <= now else "kept" if same else "outdated"
    return Enclave(agent=folder.name, state=state, not_after=valid[1])


def _certificate(
    name: str, key: Any, valid: _Times, authority: _Authority | None
) -> x509.Certificate:
    """Return a certificate of whose key a key is; without an authority, of one."""
    subject = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, name)])
    signer, issuer = (authority[0], authority[1].subject) if authority else (key, subject)
    limit = x509.BasicConstraints(ca=authority is None, path_length=None if authority else 1)
    builder = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key.public_key())
    )
    builder = builder.serial_number(x509.random_serial_number()).add_extension(
        limit, critical=not authority
    )
    return (
        builder.not_valid_before(valid[0]).not_valid_after(valid[1]).sign(signer, hashes.SHA256())
    )


def _signed(text: str, authority: _Authority) -> bytes:
    """Return a document as S/MIME with a detached signature."""
    builder = pkcs7.PKCS7SignatureBuilder().set_data(text.encode())
    builder = builder.add_signer(authority[1], authority[0], hashes.SHA256())
    return builder.sign(
        pem.Encoding.SMIME, [pkcs7.PKCS7Options.Text, pkcs7.PKCS7Options.DetachedSignature]
    )


def _read(path: Path, load: Callable[[bytes], Any]) -> Any:
    try:
        return load(path.read_bytes())
    except (ValueError, TypeError) as error:  # TypeError: it needs a password
        raise DeployError(
            f"{path}: given something else, allowed: PEM without a password: {error}"
        ) from error


def _pem(key: ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(_PEM, pem.PrivateFormat.PKCS8, pem.NoEncryption())


def _write(path: Path, content: bytes) -> None:
    """Write a new file that nobody but its owner can ever open."""
    path.parent.mkdir(mode=0o700, exist_ok=True)
    with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
        file.write(content)


@contextmanager
def _staged(folder: Path) -> Iterator[Path]:
    """Fill a folder, a new one whole or not at all."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    stage = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
    try:
        yield stage
        if folder.exists():
            for made in stage.iterdir():
                made.replace(folder / made.name)
        else:
            stage.rename(folder)
    finally:
        shutil.rmtree(stage, ignore_errors=True)
