"""Real ROS 2 beside the tests: a node of rclpy in an interpreter of its own, for each distribution."""

from __future__ import annotations

import json
import os
from contextlib import asynccontextmanager
from dataclasses import asdict, replace
from pathlib import Path

import features
import machine
import pytest
from beside import ANSWER_S

from sfglab.lab import ros2
from sfglab.processes import LineProcess


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item, call):
    """Tell the experiment `ros2`, where it runs the tests, which feature a test shows and how it ended."""
    report = yield
    if "SFGLAB_FEATURES" in os.environ and (report.when == "call" or not report.passed):
        with Path(os.environ["SFGLAB_FEATURES"]).open("a", encoding="utf-8") as told:
            for row in features.rows_of(item.obj, [item.callspec.params["distribution"]]):
                ended = replace(row, outcome=report.outcome, duration_s=round(report.duration, 2))
                told.write(json.dumps(asdict(ended)) + "\n")
    return report


@pytest.fixture(params=machine.DISTRIBUTIONS)
def distribution(request, monkeypatch):
    """A distribution's name, in our environment too: it says what ROS 2 puts on the wire."""
    monkeypatch.setenv("ROS_DISTRO", request.param)
    for name in ("ROS_LOCALHOST_ONLY", "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_STATIC_PEERS", "CYCLONEDDS_URI"):
        monkeypatch.delenv(name, raising=False)
    return request.param


@pytest.fixture
def peer(distribution, domain_id):
    """A function that starts a real node, in the test's domain or on a test host; it ends with the block."""

    @asynccontextmanager
    async def started(name="peer", host=None, **environment):
        values = {"ROS_DOMAIN_ID": domain_id, **environment}
        if host:  # hosts of a test share /dev/shm: Fast DDS would pass the link by
            values.setdefault("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")
        argv = ros2.distributions()[distribution].argv(str(ros2.PEER), name, **values)
        argv = host.argv(argv) if host else argv
        process = await LineProcess.start(name, argv)
        try:
            await process.expect("ready", timeout_s=ANSWER_S)
            yield process
        finally:
            await process.close()

    return started
