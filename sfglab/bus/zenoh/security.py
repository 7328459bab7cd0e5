"""Security of Zenoh sessions: mutual TLS and access control, from the files of `sfglab fleet certificates`.

Both sides of a link show a certificate of the same authority. Access control runs in sessions that accept
connections, and knows a sender by the common name of its certificate (`sfglab.fleet.access_control`).
"""

from __future__ import annotations

import contextlib
import json
from ssl import (
    CERT_REQUIRED,
    PROTOCOL_TLS_CLIENT,
    PROTOCOL_TLS_SERVER,
    MemoryBIO,
    SSLCertVerificationError,
    SSLContext,
    SSLWantReadError,
)
from typing import TYPE_CHECKING, Any

from sfglab.errors import InvalidValueError
from sfglab.files import read_text

if TYPE_CHECKING:
    from pathlib import Path

#: Files beside certificates: the authority's certificate, and the access control.
AUTHORITY, ACCESS = "ca.pem", "access-control.json5"


def access_settings(certificate: Path) -> Any:
    """Return Zenoh's `access_control` settings from the file beside a certificate.

    Raises:
        InvalidValueError: The file cannot be read, or contains no access control.
    """
    path = certificate.with_name(ACCESS)
    text = read_text(path, "a file of sfglab fleet certificates")
    try:
        settings = json.loads(text)["access_control"]
        is_enabled = settings["enabled"] is True
    except (ValueError, LookupError, TypeError):
        is_enabled = False
    if not is_enabled:
        raise InvalidValueError(path, text[:40], "the access control of sfglab fleet certificates")
    return settings


def certificate_fault(certificate: Path) -> str:
    """Return the reason why others refuse a certificate, or why it cannot be used; empty for none.

    A connection within the process uses it on both sides. It fails if a file is damaged, if the key or the authority
    is that of another certificate, or if the certificate has expired. Zenoh itself reports none of these reasons.
    """
    try:
        sides = [SSLContext(PROTOCOL_TLS_SERVER), SSLContext(PROTOCOL_TLS_CLIENT)]
        for side in sides:
            side.check_hostname = False
            side.verify_mode = CERT_REQUIRED
            side.load_cert_chain(certificate, certificate.with_suffix(".key"))
            side.load_verify_locations(certificate.with_name(AUTHORITY))
        ways = MemoryBIO(), MemoryBIO()
        server = sides[0].wrap_bio(*ways, server_side=True)
        client = sides[1].wrap_bio(*ways[::-1])
        for end in (client, server, client, server):
            with contextlib.suppress(SSLWantReadError):
                end.do_handshake()
    except SSLCertVerificationError as error:
        return error.verify_message
    except OSError as error:  # includes `SSLError`
        return str(error)
    return ""


def tls_settings(certificate: Path, *, verify_name: bool = True) -> dict[str, Any]:
    """Return Zenoh's `transport/link` settings of a session.

    Args:
        certificate: Certificate ``NAME.pem``, with ``NAME.key`` and `AUTHORITY` beside it.
        verify_name: Whether the other side's certificate must name the address that the session connects to, as
            a hub's does. Peers learn addresses from each other, which their certificates do not name.

    Raises:
        InvalidValueError: A file cannot be read.
    """
    files = certificate.with_name(AUTHORITY), certificate, certificate.with_suffix(".key")
    for path in files:
        read_text(path, "a file of sfglab fleet certificates")
    authority, own, key = map(str, files)
    settings = {
        "root_ca_certificate": authority,
        "listen_certificate": own,
        "listen_private_key": key,
        "connect_certificate": own,
        "connect_private_key": key,
        "enable_mtls": True,
        "verify_name_on_connect": verify_name,
    }
    # Zenoh refuses endpoints of other protocols, which have no TLS.
    return {"protocols": ["tls", "quic"], "tls": settings}
