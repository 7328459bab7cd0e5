"""The module `frames` has the sizes of RTPS messages on the medium (RTPS 2.5, clause 9.4) in plain functions.

The module `medium` compiles the functions of `frames`. A frame has the headers of Ethernet, IPv4, UDP and RTPS, and
then submessages. The submessages take the following numbers of bytes: INFO_DST 16, INFO_TS 12, DATA 24 and the
payload, padded as CDR is, HEARTBEAT 32, ACKNACK 28 and a bitmap of 32, GAP 32.
"""

from __future__ import annotations

from sfglab.rtps.state import Frame

NETWORK_BYTES = 14 + 20 + 8  #: Size of the Ethernet, IPv4 and UDP headers of a frame.
LEAST_BYTES = NETWORK_BYTES + 20  #: Size of the Ethernet, IPv4, UDP and RTPS headers of a frame.
INFO_DST_BYTES = 16
_HEARTBEAT_BYTES = 32
IP_BYTES = 14 + 20  #: Size of the Ethernet and IPv4 headers; each fragment has these headers.
#: Number of bytes of an IP packet that one frame carries (RFC 894, RFC 791).
IP_PAYLOAD_BYTES = 1480


def frame_bytes(kind: int, size_bytes: int, samples: int, heartbeats: int) -> int:
    """Return the size of a frame; if IP fragments a BURST, the size of the BURST's last frame.

    Args:
        kind: Kind of the frame, a `Frame`.
        size_bytes: CDR size of the flow's samples, bytes.
        samples: Number of samples in a BURST.
        heartbeats: Number of heartbeats that travel with DATA or in a BURST.
    """
    sample = 12 + 24 + (size_bytes + 3) // 4 * 4
    if kind == Frame.DATA:
        return LEAST_BYTES + sample + heartbeats * _HEARTBEAT_BYTES
    if kind == Frame.FRAGMENT:
        return IP_BYTES + IP_PAYLOAD_BYTES
    if kind == Frame.BURST:
        whole = LEAST_BYTES + INFO_DST_BYTES + heartbeats * _HEARTBEAT_BYTES + samples * sample
        return IP_BYTES + (whole - IP_BYTES - 1) % IP_PAYLOAD_BYTES + 1
    return LEAST_BYTES + INFO_DST_BYTES + (28 + 32 if kind == Frame.ACKNACK else 32)


def fragments(size_bytes: int, samples: int, heartbeats: int) -> int:
    """Return how many full frames precede the last frame of a BURST; the arguments are those of `frame_bytes`."""
    sample = 12 + 24 + (size_bytes + 3) // 4 * 4
    whole = LEAST_BYTES + INFO_DST_BYTES + heartbeats * _HEARTBEAT_BYTES + samples * sample
    return (whole - IP_BYTES - 1) // IP_PAYLOAD_BYTES


def data_bytes(size_bytes: int, *, with_heartbeat: bool) -> int:
    """Return the size of a frame with one sample of `size_bytes` in CDR."""
    return frame_bytes(Frame.DATA, size_bytes, 1, int(with_heartbeat))


ACKNACK_BYTES = frame_bytes(Frame.ACKNACK, 0, 0, 0)  #: Size of the frame of an acknowledgement.
