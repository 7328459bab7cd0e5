"""Common parts of a notebook's widgets: ipywidgets, own front-end classes, error messages, and addresses of pages.

The widgets come with the extra ``view``.
"""

from __future__ import annotations

import os
from html import escape
from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from sfglab.errors import MissingExtraError, SfglabError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path


def widgets() -> Any:
    """Return the package ipywidgets.

    Raises:
        MissingExtraError: ipywidgets is not installed.
    """
    try:
        return import_module("ipywidgets")
    except ImportError as error:
        raise MissingExtraError(
            "ipywidgets", extra="view", purpose="the panel in a notebook"
        ) from error


def front_end(module: Path, traits: Mapping[str, str], css: str = "") -> Any:
    """Return the class of a widget whose front end is an ES module of sfglab, made with anywidget.

    Args:
        module: File of the ES module.
        traits: Values that Python and the page share: traitlets classes, such as ``Unicode``, by name.
        css: Style rules for the page.

    Raises:
        MissingExtraError: anywidget is not installed.
    """
    try:
        anywidget, traitlets = import_module("anywidget"), import_module("traitlets")
    except ImportError as error:
        raise MissingExtraError(
            "anywidget", extra="view", purpose="this part of a notebook"
        ) from error
    members = {name: getattr(traitlets, kind)().tag(sync=True) for name, kind in traits.items()}
    members["_esm"] = module.read_text("utf-8")
    if css:
        members["_css"] = css
    return type(f"{module.stem.title()}Widget", (anywidget.AnyWidget,), members)


def button(label: str, action: Callable[[], object], tooltip: str = "") -> Any:
    """Return a button as wide as its label, which calls a function at each click."""
    # Other widgets of the row do not shrink the button.
    layout = {"width": "auto", "flex": "0 0 auto"}
    made = widgets().Button(description=label, tooltip=tooltip, layout=layout)
    made.on_click(lambda _: action())
    return made


def attempt(action: Callable[[], object], said: Any) -> bool:
    """Call a function and return whether it raised no `SfglabError`; the HTML widget `said` shows the error."""
    try:
        action()
    except SfglabError as error:
        said.value = refusal_html(str(error))
        return False
    said.value = ""
    return True


def refusal_html(text: str) -> str:
    """Return an error message as HTML; an empty text if there is no error."""
    return f'<span style="color:#b00020">{escape(text)}</span>' if text else ""


LOOPBACK = "127.0.0.1"


def address_of_port(port: int) -> str:
    """Return the URL of a page at a loopback port, behind the kernel's notebook server if there is one."""
    parent = os.environ.get("JPY_PARENT_PID")
    if parent is not None and find_spec("jupyter_server_proxy") is not None:
        from jupyter_server.serverapp import list_running_servers  # takes seconds to import

        for server in list_running_servers():
            if str(server["pid"]) == parent:
                return f"{server['base_url']}proxy/{port}/"
    return f"http://{LOOPBACK}:{port}"
