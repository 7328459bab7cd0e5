"""How many bytes a frame of the model has: the compiled medium's figures, for those who plan with them.

Knows headers and submessages; refuses to know queues and clocks. A test holds it to `medium`.
"""

from __future__ import annotations

# Ethernet 14, IPv4 20, UDP 8; RTPS header 20 (RTPS 2.5, clause 9.4).
_BASE = 14 + 20 + 8 + 20
_INFO_TS, _DATA, _HEARTBEAT = 12, 24, 32

ACKNACK_BYTES = _BASE + 16 + 28 + 32
"""INFO_DST, ACKNACK and a bitmap of 256 samples."""


def data_bytes(size_bytes: int, *, with_heartbeat: bool) -> int:
    """Return the size of a sample's frame.

    Args:
        size_bytes: CDR size of the sample; it is padded to whole words.
        with_heartbeat: Whether a HEARTBEAT rides along.
    """
    payload = (size_bytes + 3) // 4 * 4
    return _BASE + _INFO_TS + _DATA + payload + (_HEARTBEAT if with_heartbeat else 0)
