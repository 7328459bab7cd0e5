"""A component that has everything loaded and waits: ``python -m sfglab.lab.workers.idle MODULE CONFIG``.

Imports the component ``MODULE``, the bus and the types of messages that a fleet exchanges, reports ``{"is":
"idle"}``, and goes on as ``python -m MODULE CONFIG`` when one line arrives. So a start signal
starts components the way it starts compiled ones, and not Python. Nothing of it touches a network before.
"""

from __future__ import annotations

import importlib
import os
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from types import ModuleType

_MESSAGES = (
    "sfglab_interfaces/msg/AgentHeartbeat",
    "sfglab_interfaces/msg/AgentDiscoveryEvent",
    "sfglab_interfaces/msg/AgentMetadata",
)
_SERVICES = ("sfglab_interfaces/srv/GetMetadata",)
_HALVES = ("Request", "Response")


def _load(module: str) -> ModuleType:
    import cyclonedds._clayer  # noqa: F401 - what the bus would import at its first endpoint
    import uvloop  # noqa: F401 - the same, of the process's loop

    import sfglab.bus.dds.forwarder  # noqa: F401 - and at a router's first path
    from sfglab.bus.dds.clib import library
    from sfglab.bus.dds.discovery import gid_bytes, info_type
    from sfglab.messages import default_message, deserialize, serialize
    from sfglab.messages.dds import idl_struct, service_idl_struct

    library()
    halves = [half for name in _SERVICES for half in service_idl_struct(name)]
    for type_ in (*map(idl_struct, _MESSAGES), *halves, info_type(gid_bytes())):
        type_.__idl__.populate()
        type_.__idl__.fill_type_data()
    for name in (*_MESSAGES, *(f"{service}_{half}" for service in _SERVICES for half in _HALVES)):
        deserialize(serialize(default_message(name)), name)
    return importlib.import_module(module)


def _wait_for_line() -> bool:
    """Return whether a line came, and take nothing behind it: that is the component's."""
    while (byte := os.read(0, 1)) != b"\n":
        if not byte:
            return False
    return True


def main() -> None:
    """Load, wait, and become the component."""
    module, config = sys.argv[1:]
    loaded = _load(module)
    os.write(1, b'{"is": "idle"}\n')
    if _wait_for_line():
        sys.argv = [module, config]
        loaded.main()


if __name__ == "__main__":
    main()
