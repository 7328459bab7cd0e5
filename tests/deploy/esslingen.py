"""The paper's fleet and a release of it, as tests deploy them."""

from __future__ import annotations

from pathlib import Path

from sfglab.deploy.deployment import Release
from sfglab.fleet.fleet_file import load_fleet

PROJECT = Path(__file__).parents[2]
FILE = PROJECT / "data" / "fleets" / "esslingen.yaml"
FLEET = load_fleet(FILE)
LOCK = (PROJECT / "requirements.lock").read_text()
RELEASE = Release(
    version="1.2.3",
    wheel="sfglab-1.2.3-py3-none-any.whl",
    wheel_sha256="ab" * 32,
    lock=LOCK,
    fleet_text="fleet: esslingen\n",
    revision="c0ffee" * 6 + "c0ff",
    created="2026-01-02T03:04:05+00:00",
)
