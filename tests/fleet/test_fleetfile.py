"""The fleet file: what it says becomes values, and what it must not say is refused with its place."""

import copy
import re
from dataclasses import fields
from pathlib import Path

import pytest
import yaml

from sfglab.bus.zenoh.address import ZenohAddress
from sfglab.documents import DocumentError
from sfglab.fields import from_json
from sfglab.fleet import fleet_file
from sfglab.fleet.policy import TABLE_1, Direction
from sfglab.qos import LATCHED, QoSProfile, Reliability

FLEETS = Path(__file__).parents[2] / "data" / "fleets"
LAB = FLEETS / "lab.yaml"

SMALL = """\
fleet: pair
agents:
  go2:
    domain: 1
    publishes:
      - /tf
      - name: /global/go2/battery_state
        count: 2
        qos: {reliability: best_effort, depth: 5, deadline_s: 0.5}
  pi1:
    domain: 2
"""


def test_the_labs_file_is_a_fleet_whose_sensors_are_what_the_status_provider_announces():
    fleet = fleet_file.load_fleet(LAB)
    assert fleet.policy.rules == TABLE_1
    go2 = fleet.agent("go2")
    assert (fleet.global_domain, fleet.agent("workstation").global_interface) == (0, "eth0")
    go2.description.check("go2")
    color, depth = go2.description.sensors[0].streams
    assert (color.codec, color.width, color.height, color.rate_hz) == ("h264", 640, 360, 30.0)
    assert depth.camera_info_topic == "/global/go2/camera_front/aligned_depth/camera_info"


def test_short_and_long_forms_and_qos_by_value_and_by_name_become_values():
    go2, pi1 = fleet_file.read_fleet(SMALL).agents
    assert [t.name for t in go2.publishes] == ["/tf", "/global/go2/battery_state"]
    assert go2.publishes[0].qos is None
    best = Reliability.BEST_EFFORT
    assert go2.publishes[1].qos == QoSProfile(reliability=best, depth=5, deadline_ns=500_000_000)
    assert (pi1.processes, pi1.lifecycle, pi1.tf.prefix_frames) == (1, True, True)
    inner = "{domain: 1, subscribes: [{name: /tf_static, qos: latched}]}"
    fleet = fleet_file.read_fleet(f"fleet: f\nagents: {{a1: {inner}}}")
    assert fleet.agents[0].subscribes[0].qos is LATCHED


def test_rules_of_ones_own_become_a_policy():
    policy = "[rt/tf, {pattern: rt/global/*, directions: [outward]}]"
    fleet = fleet_file.read_fleet(f"fleet: f\npolicy: {policy}\nagents: {{a1: {{domain: 1}}}}")
    assert [rule.pattern for rule in fleet.policy.rules] == ["rt/tf", "rt/global/*"]
    assert fleet.policy.rules[0].directions == frozenset(Direction)
    assert fleet.policy.rules[1].directions == {Direction.OUTWARD}


def test_agents_meet_over_zenoh_if_the_file_says_so():
    assert fleet_file.read_fleet(SMALL).zenoh is None
    hubs = "global: {domain: 3, hubs: [10.0.0.1, 10.0.0.2]}"
    fleet = fleet_file.read_fleet(f"{SMALL}{hubs}\n")
    assert fleet.zenoh == ZenohAddress(domain_id=3, hubs=("10.0.0.1", "10.0.0.2"))
    words = "fleet.yaml:12: global: given 'udp', allowed: tcp without certificates; udp loses"
    with pytest.raises(DocumentError, match=words):
        fleet_file.read_fleet(f"{SMALL}global: {{peers: [udp/a]}}\n")
    words = "fleet.yaml:12: global.certificates: given 'keys', .* with hubs or peers, because DDS"
    with pytest.raises(DocumentError, match=words):
        fleet_file.read_fleet(f"{SMALL}global: {{certificates: keys}}\n")


@pytest.mark.parametrize(
    ("change", "key", "line", "part"),
    [
        (("domain: 2", "domain: 233"), "agents.pi1.domain", 11, "a whole number from 0 to 232"),
        (
            ("depth: 5", "depth: 0"),
            "agents.go2.publishes[1].qos.depth",
            9,
            "from 1",
        ),
        (("count: 2", "rate_hz: 1"), "agents.go2.publishes[1].rate_hz", 8, "allowed"),
        (("pi1:", "torq:"), "agents.torq", 10, "a DDS router breaks it"),
        (("pi1:", "camera_1:"), "agents.camera_1", 10, "mistaken"),
        (("/tf\n", "tf\n"), "agents.go2.publishes[0]", 6, "absolute name"),
        (
            ("fleet: pair\n", "policy: table-2\nfleet: pair\n"),
            "policy",
            1,
            "did you mean 'table-1'?",
        ),
        (
            ("fleet: pair\n", "policy: []\nfleet: pair\n"),
            "policy",
            1,
            "no topic is forwarded without a rule",
        ),
        (
            ("fleet: pair\n", "fleet: pair\ndescriptions: asked\n"),
            "descriptions",
            2,
            "allowed: published or queried",
        ),
    ],
)
def test_a_mistake_is_refused_with_its_key_its_line_and_what_is_allowed(change, key, line, part):
    with pytest.raises(DocumentError) as caught:
        fleet_file.read_fleet(SMALL.replace(*change))
    error = caught.value
    assert (error.place.key, error.place.line) == (key, line)
    assert part in str(error)
    assert str(error).startswith("fleet.yaml:")
    assert str(copy.deepcopy(error)) == str(error), (
        "also in another process: the same protocol as pickling"
    )


# Where it runs


def fleet_with(host="{}", deployment="{}"):
    agents = f"agents: {{go2: {{domain: 1, host: {host}}}}}"
    return fleet_file.read_fleet(f"fleet: My Lab\ndeployment: {deployment}\n{agents}\n")


def test_all_keys_are_read():
    host = (
        "{model: M, address: sfg@go2.local, architecture: arm64, accelerator: jetson, network: host, "
        "devices: [/dev/video0], workspace: ws/go2, packages: [libusb-1.0-0, g++], launch: [ros2, a b]}"
    )
    deployment = (
        "{images: 'reg.example:5000/lab/go', ros: jazzy, router: dds-router, "
        "router_image: 'ubuntu-ddsrouter:v3.5.0', time_servers: [go2, ptbtime1.ptb.de]}"
    )
    fleet = fleet_with(host, deployment)
    for given, read in ((host, fleet.agents[0].host), (deployment, fleet.deployment)):
        values = yaml.safe_load(given)
        assert {f.name for f in fields(read)} - {"place"} == values.keys()
        assert read == from_json(type(read), values)


@pytest.mark.parametrize(
    ("part", "text", "key", "allowed"),
    [
        ("host", "{devices: [video0]}", "agents.go2.host.devices", "device nodes"),
        ("host", "{devices: [/dev/../etc/shadow]}", "agents.go2.host.devices", "device nodes"),
        ("host", "{packages: ['curl; rm -rf /']}", "agents.go2.host.packages", "Debian packages"),
        (
            "host",
            "{workspace: ../elsewhere}",
            "agents.go2.host.workspace",
            "a folder beside the fleet file",
        ),
        ("host", "{address: '-oProxyCommand=x'}", "agents.go2.host.address", "[user@]host"),
        ("host", r'{launch: ["a\n"]}', "agents.go2.host.launch", "a text of one line"),
        ("host", r'{"model\u2028": a}', "agents.go2.host.model", "a key of one line"),
        ("deployment", "{images: Localhost/UPPER}", "deployment.images", "a repository of images"),
        ("deployment", "{router_image: 'a b'}", "deployment.router_image", "an image"),
        ("deployment", "{time_servers: ['x y']}", "deployment.time_servers", "names or addresses"),
    ],
)
def test_a_machine_or_deployment_that_cannot_be_is_refused_with_place_and_allowed(
    part, text, key, allowed
):
    with pytest.raises(DocumentError, match=rf"{re.escape(key)}.*{re.escape(allowed)}"):
        fleet_with(**{part: text})
