"""Widgets of a notebook: the library, front-end parts of our own, and how a refusal looks.

Refuses to know what any of them shows. They come with the extra ``view``.
"""

from __future__ import annotations

from html import escape
from importlib import import_module
from typing import TYPE_CHECKING, Any

from sfglab.errors import MissingExtraError

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path


def widgets() -> Any:
    """Return ipywidgets.

    Raises:
        MissingExtraError: They are not installed.
    """
    try:
        return import_module("ipywidgets")
    except ImportError as error:
        raise MissingExtraError("ipywidgets", extra="view", purpose="the panel in a notebook") from error


def front_end(module: Path, traits: Mapping[str, str]) -> Any:
    """Return the class of a widget whose part in the page is an ES module of our own.

    Args:
        module: The module's file.
        traits: What both sides share: names, and what traitlets calls their kinds, as ``Unicode``.

    Raises:
        MissingExtraError: anywidget is not installed.
    """
    try:
        anywidget, traitlets = import_module("anywidget"), import_module("traitlets")
    except ImportError as error:
        raise MissingExtraError("anywidget", extra="view", purpose="this part of a notebook") from error
    members = {name: getattr(traitlets, kind)().tag(sync=True) for name, kind in traits.items()}
    members["_esm"] = module.read_text("utf-8")
    return type(f"{module.stem.title()}Widget", (anywidget.AnyWidget,), members)


def refusal_html(text: str) -> str:
    """Return a sentence that says what was refused, as HTML; nothing for nothing."""
    return f'<span style="color:#b00020">{escape(text)}</span>' if text else ""
