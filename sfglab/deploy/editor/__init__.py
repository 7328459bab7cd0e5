"""An agent's folder in VS Code: development container, debugging, building, formatting (paper A, 4.4)."""

from __future__ import annotations

from sfglab.deploy.editor.check import check_editor
from sfglab.deploy.editor.files import editor_files

__all__ = ["check_editor", "editor_files"]
