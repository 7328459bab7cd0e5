"""The helper process for services of ROS 2: its parts, and the error where it cannot run."""

import ast
import asyncio
import sys
from pathlib import Path

import pytest

from sfglab.bus import Node
from sfglab.bus.api import RawEndpoint
from sfglab.bus.ros import services
from sfglab.messages import ServiceFrame, default_message, frame_service, serialize
from sfglab.qos import DEFAULT

STRING = "std_msgs/msg/String"

# It takes the place of the interpreter, and opens what it is ordered to at once.
STAND_IN = """#!{python}
import json, sys

def report(**values):
    print(json.dumps(values), flush=True)

report(**{{"is": "ready", "prefix": "010f" + 20 * "0"}})
for line in sys.stdin:
    order = json.loads(line)
    with open({orders!r}, "a") as file:
        print(order["do"], order["key"], file=file)
    if order["do"] == "open":
        report(**{{"is": "matched", "key": order["key"], "ready": True}})
"""


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


@pytest.mark.live
@pytest.mark.parametrize("running", [False, True], ids=["before it runs", "while it runs"])
@pytest.mark.parametrize("role", ["server", "client"])
@pytest.mark.parametrize("halves", [("rq", "rr"), ("rr", "rq")], ids=" then ".join)
async def test_a_server_or_client_opens_with_both_halves_and_closes_with_the_last(
    domain_id, monkeypatch, tmp_path, until, running, role, halves
):
    python, orders = tmp_path / "python", tmp_path / "orders"
    python.write_text(STAND_IN.format(python=sys.executable, orders=str(orders)))
    python.chmod(0o700)
    monkeypatch.setenv(services.PYTHON_VARIABLE, str(python))

    def opened(ros, name, half):
        endpoint = RawEndpoint(
            dds_topic=f"{half}/{name}{'Request' if half == 'rq' else 'Reply'}",
            type="std_srvs/srv/SetBool_Request",
            qos=DEFAULT,
            transport="ros",
        )
        reads = (half == "rq") is (role == "server")
        return ros.open(endpoint, lambda: None, object() if reads else None)

    async with Node("us", domain_id=domain_id) as node:
        ros = node.backend.ros
        if running:
            ros.start()
            await until(lambda: ros.participants)
        first = opened(ros, "a", halves[0])
        first.write(frame_service(ServiceFrame(1, 1, serialize(default_message(STRING)))))
        others = [opened(ros, "b", half) for half in halves]
        await until(lambda: all(half.matched for half in others))
        assert not first.matched  # orders are carried out one after the other
        second = opened(ros, "a", halves[1])
        await until(lambda: first.matched and second.matched)
        first.close()
        first = opened(ros, "a", halves[0])
        assert first.matched
        for half in (second, first):
            half.close()
        await until(lambda: "close" in orders.read_text())
        assert not opened(ros, "a", halves[0]).matched, "it waits for its other half again"
    carried_out = [f"open {role} /b", f"open {role} /a", f"close {role} /a"]
    assert orders.read_text().splitlines() == carried_out
