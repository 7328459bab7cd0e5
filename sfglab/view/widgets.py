"""Widgets of a notebook: the library, front-end parts of our own, how a refusal looks, and addresses of pages.

Refuses to know what any of them shows. They come with the extra ``view``.
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
    """Return ipywidgets; MissingExtraError where they are not installed."""
    try:
        return import_module("ipywidgets")
    except ImportError as error:
        raise MissingExtraError(
            "ipywidgets", extra="view", purpose="the panel in a notebook"
        ) from error


def front_end(module: Path, traits: Mapping[str, str], css: str = "") -> Any:
    """Return the class of a widget whose part in the page is an ES module of our own, through anywidget.

    Args:
        module: File of the ES module.
        traits: Names of the values that Python and page share, with their classes in traitlets, as ``Unicode``.
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
    """Return a button as wide as its label, and what it does."""
    layout = {"width": "auto", "flex": "0 0 auto"}  # what stands beside it does not shrink it
    made = widgets().Button(description=label, tooltip=tooltip, layout=layout)
    made.on_click(lambda _: action())
    return made


def attempt(action: Callable[[], object], said: Any) -> bool:
    """Do something, and say in an HTML widget what is refused; return whether nothing was."""
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
    """Return the address of a page at a port of loopback, below the kernel's notebook server if any."""
    parent = os.environ.get("JPY_PARENT_PID")
    if parent is not None and find_spec("jupyter_server_proxy") is not None:
        from jupyter_server.serverapp import list_running_servers  # takes seconds to import

        for server in list_running_servers():
            if str(server["pid"]) == parent:
                return f"{server['base_url']}proxy/{port}/"
    return f"http://{LOOPBACK}:{port}"
