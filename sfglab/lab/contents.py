"""Notebooks as JupyterLab reads and writes them for `sfglab lab`: reading one leaves it as it is.

When a kernel starts, JupyterLab writes the kernel's description of its language into the notebook,
with the version of Python, and then takes the notebook for changed: it asks to save it. So a
notebook arrives with the description that the kernel will give, and is saved without it.
"""

from __future__ import annotations

from typing import Any

from ipykernel.ipkernel import IPythonKernel
from jupyter_server.services.contents.largefilemanager import AsyncLargeFileManager

COMMITTED = {"name": "python"}
"""Description of the language in notebooks under version control."""


class Contents(AsyncLargeFileManager):  # type: ignore[misc]  # it carries no types
    """The files of a checkout; notebooks keep no version of Python."""

    async def get(self, path: str, content: bool = True, **options: Any) -> dict[str, Any]:  # noqa: FBT001, FBT002
        """Return a file; a notebook for Python with the language that this Python's kernel has."""
        model: dict[str, Any] = await super().get(path, content=content, **options)
        _describe(model, IPythonKernel.language_info)
        return model

    async def save(self, model: dict[str, Any], path: str = "") -> dict[str, Any]:
        """Write a file; a notebook for Python without the version of Python."""
        _describe(model, COMMITTED)
        saved: dict[str, Any] = await super().save(model, path)
        return saved


def _describe(model: dict[str, Any], language: dict[str, Any]) -> None:
    """Set the language of a notebook for Python; other files stay as they are."""
    if model.get("type") != "notebook" or not model.get("content"):
        return
    metadata = model["content"].get("metadata", {})
    if metadata.get("language_info", {}).get("name") == COMMITTED["name"]:
        metadata["language_info"] = dict(language)
