from __future__ import annotations

import json
import os
import platform
import re
import socket
from pathlib import Path

import numpy as np

from sfglab import __version__
from sfglab.record import LogReader, LogWriter, run_context


def test_context_names_versions_and_machine():
    context = run_context()
    assert context["sfglab"] == __version__
    assert context["python"] == platform.python_version()
    assert context["libraries"]["numpy"] == np.__version__
    assert context["machine"]["usable_cores"] == len(os.sched_getaffinity(0))
    assert context["machine"]["memory_bytes"] > 2**28
    assert context["machine"]["cpu"]


def test_context_identifies_neither_place_nor_host():
    text = json.dumps(run_context())
    assert socket.gethostname() not in text
    assert str(Path.home()) not in text
    assert not re.search(r'"/', text)


def test_source_is_a_commit_or_absent():
    source = run_context()["source"]
    if source:
        assert re.fullmatch(r"[0-9a-f]{40}", source["git_commit"])
        assert isinstance(source["git_clean"], bool)


def test_context_survives_a_log(tmp_path):
    context = run_context()
    with LogWriter(tmp_path / "run.mcap") as log:
        log.write_metadata("run", context)
    with LogReader(tmp_path / "run.mcap") as log:
        assert log.metadata("run") == context
