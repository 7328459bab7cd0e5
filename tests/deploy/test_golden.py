"""Files of the paper's fleet as they were reviewed; ``python tests/deploy/test_golden.py`` writes them again."""

import re
from dataclasses import replace
from pathlib import Path

import pytest
from esslingen import FLEET, GO2, LAB, deployed

from sfglab.deploy.bundle import render_bundle
from sfglab.deploy.dds_router import render_dds_router

GOLDEN = Path(__file__).parent / "golden"
REVIEWED = sorted(path for path in GOLDEN.rglob("*") if path.is_file())


def rendered(file):
    """Return a file with digests left out, which follow the lock file."""
    agent, *parts = file.relative_to(GOLDEN).parts
    if file.name == "dds_router.yaml":
        return render_dds_router(LAB, agent)
    text = render_bundle(deployed(agent))["/".join(parts)].text
    return re.sub(r"\b[0-9a-f]{64}\b", "<sha256>", text)


BENT = replace(FLEET, name="a\nservices: {evil: {image: b}}\u2028privileged: true\r\x85c: d")


@pytest.mark.parametrize("target", ["compose.yaml", "compose.dev.yaml", "Dockerfile", "dds-router"])
def test_a_fleets_name_adds_no_line_to_a_file(target):
    counts = set()
    for fleet in (FLEET, replace(FLEET, name="one"), BENT):
        if target == "dds-router":
            text = render_dds_router(fleet, "go2")
        else:
            text = render_bundle(replace(GO2, fleet=fleet))[target].text
        counts.add(len(text.splitlines()))
    assert len(counts) == 1


@pytest.mark.parametrize("file", REVIEWED, ids=lambda file: str(file.relative_to(GOLDEN)))
def test_a_file_is_the_one_that_was_reviewed(file):
    assert rendered(file) == file.read_text(encoding="utf-8")


if __name__ == "__main__":
    for file in REVIEWED:
        file.write_text(rendered(file), encoding="utf-8")
