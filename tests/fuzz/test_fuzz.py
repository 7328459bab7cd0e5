"""No input through any door of `doors` does more than be refused; ``make fuzz`` tries for longer."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.timeout(300)
def test_whatever_strangers_send_is_answered_or_refused_at_its_door():
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    argv = [sys.executable, str(Path(__file__).with_name("run.py"))]
    done = subprocess.run(argv, env=environment, stdout=subprocess.PIPE, text=True, check=True)
    found = json.loads(done.stdout)
    assert found["faults"] == {}
    assert min(found["counts"].values()) > 50
    assert max(found["peak_mb"].values()) < 300
