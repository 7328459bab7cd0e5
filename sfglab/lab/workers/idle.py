"""Component that loads everything and waits: ``python -m sfglab.lab.workers.idle MODULE CONFIG``.

The process imports the component ``MODULE``, the bus and the message types that a fleet exchanges. It
reports ``{"is": "idle"}``, and continues as ``python -m MODULE CONFIG`` when one line arrives. A start
signal then costs no time to load Python and its modules, as with compiled components. The process uses no
network before that.
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
_SERVICE = "sfglab_interfaces/srv/GetMetadata"


def _load(module: str) -> ModuleType:
    import cyclonedds._clayer  # noqa: F401 - imported by the bus at its first endpoint
    import uvloop  # noqa: F401 - imported by the process's event loop

    import sfglab.bus.dds.forwarder  # noqa: F401 - imported at a router's first path
    from sfglab.bus.dds.clib import library
    from sfglab.bus.dds.discovery import gid_bytes, info_type
    from sfglab.messages import default_message, deserialize, serialize
    from sfglab.messages.dds import idl_struct, service_idl_struct

    library()
    halves = service_idl_struct(_SERVICE)
    for type_ in (*map(idl_struct, _MESSAGES), *halves, info_type(gid_bytes())):
        type_.__idl__.populate()
        type_.__idl__.fill_type_data()
    for name in (*_MESSAGES, f"{_SERVICE}_Request", f"{_SERVICE}_Response"):
        deserialize(serialize(default_message(name)), name)
    return importlib.import_module(module)


def _wait_for_line() -> bool:
    """Return whether a line arrived; later bytes belong to the component and are not read."""
    while (byte := os.read(0, 1)) != b"\n":
        if not byte:
            return False
    return True


def main() -> None:
    """Load everything, wait, and run the component."""
    module, config = sys.argv[1:]
    loaded = _load(module)
    os.write(1, b'{"is": "idle"}\n')
    if _wait_for_line():
        sys.argv = [module, config]
        loaded.main()


if __name__ == "__main__":
    main()
