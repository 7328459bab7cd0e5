"""Files of an agent's folder, and what each is for in a sentence."""

from __future__ import annotations

from fnmatch import fnmatchcase

_MEANINGS = (
    ("Dockerfile", "the image in three layers: hardware base, adapter, application"),
    (".dockerignore", "what the builder may see: the folder image and the workspace, nothing else"),
    ("image/requirements.lock", "every library of the image, with version and digests"),
    ("image/development.lock", "what development adds: a debugger for Python, a formatter for CMake"),
    ("image/cyclonedds*.lock", "what building the middleware takes, which has no wheel for this processor"),
    ("image/wheels/*", "wheels for machines without a way to the package index"),
    ("image/fleet.yaml", "the fleet file, as the containers read it"),
    ("image/entrypoint.sh", "starts the agent and, beside it, the user's software"),
    ("image/*.whl", "sfglab itself"),
    ("workspace/*", "the user's sources, built into the image"),
    ("compose.yaml", "the two containers, agent and router, and the bridge between them"),
    ("compose.dev.yaml", "what development changes: the workspace as a folder, a shell, a debugger"),
    ("release.env", "the release that runs; the hooks make .env of it, with the machine's own numbers"),
    ("router/*", "the configuration of the router that the fleet uses"),
    ("hooks/initialize.sh", "makes the machine ready: runs the hooks, then the user's own; --dry-run shows"),
    ("hooks/settings.sh", "what differs from agent to agent, for the hooks"),
    ("hooks/lib.sh", "what the hooks have in common: write only what differs, say what was done"),
    ("hooks/10-time.sh", "the clock goes by the fleet's time servers"),
    ("hooks/20-firewall.sh", "loads the firewall"),
    ("hooks/firewall.nft", "the agent's own domain does not leave the machine"),
    ("hooks/30-service.sh", "installs the service, so that the agent starts with the machine"),
    ("hooks/custom.d/*", "where the user's own hooks belong"),
    ("systemd/*", "starts both containers with the machine and stops them with it"),
    (".devcontainer/*", "the same containers as a development environment in VS Code"),
    (".vscode/launch.json", "debugging of Python and C++ nodes, with their arguments"),
    (".vscode/tasks.json", "building and testing the workspace"),
    (".vscode/*", "editor settings: completion, formatting, extensions"),
    ("manifest.json", "what belongs to the release, with digests"),
)


def meaning_of(path: str) -> str:
    """Return what a file is for, empty for one that no bundle has.

    Args:
        path: Within the agent's folder.
    """
    return next((meaning for pattern, meaning in _MEANINGS if fnmatchcase(path, pattern)), "")
