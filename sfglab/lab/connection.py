"""Connection of `sfglab lab` between a page and a kernel, without TCP's wait for small messages.

As Jupyter Server opens it, TCP holds a small message until the browser has acknowledged the message
before, which takes 40 ms. An explorer would be that much later after each move of a slider.
"""

from __future__ import annotations

from typing import Any

from jupyter_server.services.kernels.connection.channels import ZMQChannelsWebsocketConnection


class PromptConnection(ZMQChannelsWebsocketConnection):  # type: ignore[misc]  # it carries no types
    """Connection that sends each message of the kernel at once."""

    def connect(self) -> Any:
        """Connect the page to the kernel."""
        self.websocket_handler.set_nodelay(True)
        return super().connect()
