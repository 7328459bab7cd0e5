"""What sfglab writes into DDS USER_DATA, in the `key=value;` form that ROS 2 uses there.

Pure text. ROS 2 writes `enclave=/;` on participants and `typehash=..;`, `serviceid=..;` on endpoints the same
way, and readers ignore keys that they do not know.
"""

from __future__ import annotations

NODE_KEY = "sfglab.node"
HOST_KEY = "sfglab.host"
SHM_KEY = "sfglab.shm"
SHM_PARTITION = "sfglab.shm"
"""Shared-memory endpoints show themselves in this partition, where no ordinary endpoint matches them."""


def entries(data: bytes) -> dict[str, str]:
    """Return the entries of USER_DATA; what has another form is left out."""
    pairs = (part.partition("=") for part in data.decode(errors="replace").split(";"))
    return {key: value for key, separator, value in pairs if separator}


def user_data(values: dict[str, str]) -> bytes:
    """Return USER_DATA with these entries, in their order."""
    return "".join(f"{key}={value};" for key, value in values.items()).encode()
