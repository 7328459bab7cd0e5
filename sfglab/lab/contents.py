"""Contents manager of `sfglab lab`: a notebook that was only read stays unchanged.

When a kernel starts, JupyterLab writes the kernel's `language_info`, with the version of Python,
into the notebook. If this changes the notebook, JupyterLab asks to save it on closing. So the server
sends each notebook with the `language_info` of its own kernel, and saves only the language's name.
"""

from __future__ import annotations

from typing import Any

from ipykernel.ipkernel import IPythonKernel
from jupyter_server.services.contents.largefilemanager import AsyncLargeFileManager

COMMITTED = {"name": "python"}
"""`language_info` of a saved notebook."""


class Contents(AsyncLargeFileManager):  # type: ignore[misc]  # it carries no types
    """Files of a checkout, with notebooks that hold no version of Python."""

    async def get(self, path: str, content: bool = True, **options: Any) -> dict[str, Any]:  # noqa: FBT001, FBT002
        """Return a file; a Python notebook gets the `language_info` of this server's kernel."""
        model: dict[str, Any] = await super().get(path, content=content, **options)
        _describe(model, IPythonKernel.language_info)
        return model

    async def save(self, model: dict[str, Any], path: str = "") -> dict[str, Any]:
        """Write a file; a Python notebook loses the version of Python."""
        _describe(model, COMMITTED)
        saved: dict[str, Any] = await super().save(model, path)
        return saved


def _describe(model: dict[str, Any], language: dict[str, Any]) -> None:
    """Set the `language_info` of a Python notebook; other files stay as they are."""
    if model.get("type") != "notebook" or not model.get("content"):
        return
    metadata = model["content"].get("metadata", {})
    if metadata.get("language_info", {}).get("name") == COMMITTED["name"]:
        metadata["language_info"] = dict(language)
