"""Security of Zenoh sessions: mutual TLS and access control, from the files of `sfglab fleet certificates`.

Both sides of a link show a certificate of the same authority. Access control runs in sessions that accept
connections, and knows a sender by the common name of its certificate (`sfglab.fleet.access_control`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sfglab.files import read_text

if TYPE_CHECKING:
    from pathlib import Path

#: Files beside certificates: the authority's certificate, and the access control.
AUTHORITY, ACCESS = "ca.pem", "access-control.json5"


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
