"""A short soak test ends without problems; ``make soak`` runs longer ones."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.live
@pytest.mark.netns
@pytest.mark.slow
@pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler (cc)")
def test_all_streams_recover_from_a_few_faults():
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    # The time of a recovery depends on the machine.
    argv = [sys.executable, str(Path(__file__).with_name("run.py")), "0.7", "--limit", "60"]
    done = subprocess.run(argv, env=environment, stdout=subprocess.PIPE, text=True, check=False)
    assert done.returncode == 0, done.stdout
    assert done.stdout.endswith(" faults, 0 problems\n")
