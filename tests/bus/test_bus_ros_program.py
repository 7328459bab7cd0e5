"""The program that serves ROS 2's own services: what it is made of, and what is said where it cannot run."""

import ast
import asyncio
import sys
from pathlib import Path

import pytest

from sfglab.bus import Node
from sfglab.bus.ros import services


def test_it_is_of_python_3_10_and_imports_only_rclpy():
    source = (Path(services.__file__).parent / "program.py").read_text(encoding="utf-8")
    nodes = list(ast.walk(ast.parse(source, feature_version=(3, 10))))
    names = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    names |= {node.module for node in nodes if isinstance(node, ast.ImportFrom)}
    assert {name.partition(".")[0] for name in names} - sys.stdlib_module_names == {"rclpy"}


def test_both_topics_of_a_service_are_one_participant_s_whatever_its_name():
    gids = {
        topic: services.ros_gid(topic)
        for topic in ("rq/aReplyRequest", "rr/aReplyReply", "rq/aRequest")
    }
    assert {len(gid) for gid in gids.values()} == {16}
    assert len(set(gids.values())) == 3
    assert gids["rq/aReplyRequest"][:12] == gids["rr/aReplyReply"][:12] != gids["rq/aRequest"][:12]
    assert services.service_of("rq/rr/aReplyRequest") == "/rr/aReply"


@pytest.mark.live
@pytest.mark.parametrize(
    ("python", "said"),
    [
        ("", "there is none here"),
        (sys.executable, "has no rclpy"),
        ("/no/python", "ended with status 127"),
    ],
)
async def test_why_nothing_can_be_served_is_said(domain_id, monkeypatch, python, said):
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)
    monkeypatch.setenv(services.PYTHON_VARIABLE, python)
    async with Node("us", domain_id=domain_id) as node:
        node.backend.ros.start()
        for _ in range(2):
            told = asyncio.get_running_loop().create_future()
            node.backend.ros.find("std_srvs/srv/SetBool_Request", "us", told.set_result)
            assert said in await told
