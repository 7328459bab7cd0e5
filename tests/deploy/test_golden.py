"""Files of the paper's fleet as they were reviewed; ``python tests/deploy/test_golden.py`` writes them again."""

import difflib
import re
from dataclasses import replace
from pathlib import Path

import pytest
from esslingen import FLEET, RELEASE

from sfglab.deploy.bundle import render_bundle
from sfglab.deploy.dds_router import render_dds_router
from sfglab.deploy.deployment import deployment_of

GOLDEN = Path(__file__).parent / "golden"
REVIEWED = {
    "go2": (
        "Dockerfile",
        ".dockerignore",
        "compose.yaml",
        "compose.dev.yaml",
        "systemd/sfglab-go2.service",
        "hooks/settings.sh",
        "hooks/firewall.nft",
        ".devcontainer/devcontainer.json",
        ".vscode/launch.json",
        ".vscode/settings.json",
    ),
    "pi1": ("Dockerfile", "compose.yaml"),
    "steamdeck": ("Dockerfile", "compose.yaml"),
    "workstation": ("Dockerfile", "compose.yaml", "hooks/settings.sh"),
}


def rendered(agent: str, path: str) -> str:
    """Return a file with digests left out, which follow the lock file."""
    text = render_bundle(deployment_of(FLEET, agent, RELEASE))[path].text
    return re.sub(r"\b[0-9a-f]{64}\b", "<sha256>", text)


BENT = replace(FLEET, name="a\nservices: {evil: {image: b}}\u2028privileged: true\r\x85c: d")


@pytest.mark.parametrize("target", ["compose.yaml", "compose.dev.yaml", "Dockerfile", "dds-router"])
def test_a_fleets_name_adds_no_line_to_a_file(target):
    fleets = (FLEET, replace(FLEET, name="one"), BENT)
    if target == "dds-router":
        given = [render_dds_router(fleet, "go2") for fleet in fleets]
    else:
        given = [
            render_bundle(deployment_of(fleet, "go2", RELEASE))[target].text for fleet in fleets
        ]
    assert len({len(text.splitlines()) for text in given}) == 1


def golden(agent: str, path: str) -> Path:
    return GOLDEN / agent / path.replace("/", "_")


@pytest.mark.parametrize(
    ("agent", "path"), [(agent, path) for agent in REVIEWED for path in REVIEWED[agent]]
)
def test_a_file_is_the_one_that_was_reviewed(agent, path):
    file = golden(agent, path)
    expected, text = file.read_text(encoding="utf-8"), rendered(agent, path)
    lines = difflib.unified_diff(
        expected.splitlines(), text.splitlines(), file.name, "rendered", lineterm=""
    )
    difference = "\n".join(lines)
    assert not difference, f"\n{difference}"


def write() -> None:
    for agent, paths in REVIEWED.items():
        for path in paths:
            golden(agent, path).parent.mkdir(parents=True, exist_ok=True)
            golden(agent, path).write_text(rendered(agent, path), encoding="utf-8")


if __name__ == "__main__":
    write()
