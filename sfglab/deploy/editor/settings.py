"""Code completion and formatting in VS Code for C++, Python and CMake, and the extensions that do it.

Completion of C++ is clangd's, fed by colcon's compile commands; of Python by the folders of the distribution
and of the workspace. One formatter a language, each by the files its project brings (``.clang-format``,
``ruff.toml`` or ``pyproject.toml``, ``.cmake-format``).
"""

from __future__ import annotations

from typing import Any

from sfglab.deploy.editor.ros import ENVIRONMENT_FILE, INTERPRETER, PYTHON
from sfglab.fleet.fleet_file import RosDistribution

_CLANGD = "llvm-vs-code-extensions.vscode-clangd"

DEBUGGERS = {"debugpy": "ms-python.debugpy", "lldb": "vadimcn.vscode-lldb"}
"""Extension that brings each type of debugger."""

FORMATTERS = {"c": _CLANGD, "cpp": _CLANGD, "python": "charliermarsh.ruff", "cmake": "cheshirekow.cmake-format"}
"""Extension that formats each language: clangd by clang-format's rules, Ruff, cmake-format."""

_OTHERS = ("ms-python.python", "ms-vscode.cmake-tools", "redhat.vscode-yaml")
EXTENSIONS = tuple(sorted({*_OTHERS, *DEBUGGERS.values(), *FORMATTERS.values()}))
"""All that a workspace needs: the same without ROS, because nodes in C++ need none."""

_BUILT = ("build", "install", "log")


def workspace_settings(ros: RosDistribution) -> dict[str, Any]:
    """Return ``settings.json``.

    Args:
        ros: The distribution in the images; without one, nothing of it or of colcon is set.
    """
    return _completion(ros) | _formatting() | (_colcon(ros) if ros is not RosDistribution.NONE else {})


def _completion(ros: RosDistribution) -> dict[str, Any]:
    return {
        "python.defaultInterpreterPath": INTERPRETER if ros is RosDistribution.NONE else "/usr/bin/python3",
        "clangd.arguments": ["--compile-commands-dir=${workspaceFolder}/build", "--header-insertion=never"],
        # CMake packages are configured by the build, not by opening a folder.
        "cmake.configureOnOpen": False,
        "python.analysis.typeCheckingMode": "basic",
    }


def _formatting() -> dict[str, Any]:
    languages: dict[str, dict[str, Any]] = {
        f"[{name}]": {"editor.defaultFormatter": tool} for name, tool in FORMATTERS.items()
    }
    languages["[python]"] |= {"editor.codeActionsOnSave": {"source.organizeImports": "explicit"}}
    return {"editor.formatOnSave": True, "files.insertFinalNewline": True, **languages}


def _colcon(ros: RosDistribution) -> dict[str, Any]:
    python = f"python{PYTHON[ros]}"
    prefix = f"/opt/ros/{ros.value}"
    paths = [f"{prefix}/lib/{python}/site-packages", f"{prefix}/local/lib/{python}/dist-packages"]
    built = dict.fromkeys((f"**/{folder}/**" for folder in _BUILT), True)
    return {
        "python.envFile": f"${{workspaceFolder}}/{ENVIRONMENT_FILE}",
        "python.analysis.extraPaths": paths,
        "files.watcherExclude": built,
        "search.exclude": built,
    }
