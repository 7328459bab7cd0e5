"""Addresses at which the browser that shows a notebook finds what its kernel's machine serves."""

from __future__ import annotations

import os
from importlib.util import find_spec

LOOPBACK = "127.0.0.1"


def address_of_port(port: int) -> str:
    """Return the address of a page that this machine serves at a port of its loopback.

    Below the notebook server's own path where one runs this kernel, so that it works through whatever leads
    to that server; else on the loopback.
    """
    if find_spec("jupyter_server_proxy") is not None:
        from jupyter_server.serverapp import list_running_servers

        for server in list_running_servers():
            if str(server["pid"]) == os.environ.get("JPY_PARENT_PID"):
                return f"{server['base_url']}proxy/{port}/"
    return f"http://{LOOPBACK}:{port}"
