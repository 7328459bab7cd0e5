"""Exported QoS: what each file says is the plan, and those who read such files accept it."""

import subprocess
import sys
from dataclasses import replace
from functools import cache, partial
from itertools import product
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
import yaml

from sfglab.arp import load_topics, plan_as_printed, plan_file
from sfglab.arp.exports import cyclone_xml, fast_dds_xml, ros2_parameters
from sfglab.errors import InvalidValueError
from sfglab.qos import Reliability
from sfglab.rtps import CYCLONE_DDS

DATA = Path(__file__).parents[2] / "data" / "qos"
PAPER_B = load_topics(DATA / "paper_b.yaml")


# Elements of what we write, in the schemas that Fast DDS ships (resources/xsd: generation 2,
# fastRTPS_profiles.xsd; generation 3, fastdds_profiles.xsd).
NAMES = {
    "topic",
    "qos",
    "times",
    "historyMemoryPolicy",
    "historyQos",
    "kind",
    "depth",
    "resourceLimitsQos",
    "max_samples",
    "max_instances",
    "max_samples_per_instance",
    "deadline",
    "durability",
    "reliability",
    "period",
    "sec",
    "nanosec",
}
LIMITS = ("max_samples", "max_instances", "max_samples_per_instance")
TIMES = {
    2: ("heartbeatPeriod", "nackResponseDelay", "heartbeatResponseDelay"),
    3: ("heartbeat_period", "nack_response_delay", "heartbeat_response_delay"),
}


CHANGED = {"cached": True, "reliability": Reliability.BEST_EFFORT}
PLANS = {
    "Fast DDS": (plan_file, PAPER_B),
    "deep": (plan_as_printed, PAPER_B.limited_to(500)),
    "cached": (plan_file, replace(PAPER_B, topics=(replace(PAPER_B.topics[0], **CHANGED),))),
    "Cyclone DDS": (plan_file, load_topics(DATA / "warehouse.yaml")),
}


@cache
def planned(name: str):
    method, given = PLANS[name]
    return method(given)


def local(element: ET.Element) -> str:
    return element.tag.rpartition("}")[2]


def texts(element: ET.Element) -> dict[str, str]:
    """Return the texts in an element by their path, without those of the first level."""
    found = {}
    for inner in element:
        found[local(inner)] = inner.text or ""
        for path, text in texts(inner).items():
            found[f"{local(inner)}/{path}"] = text
    return found


def profiles(text: str) -> dict[tuple[str, str], dict[str, str]]:
    """Return the texts of each profile, by its kind and topic."""
    top = ET.fromstring(text)[-1]  # noqa: S314 - our own text
    return {(local(profile), profile.get("profile_name", "")): texts(profile) for profile in top}


@pytest.mark.parametrize("name", ["Fast DDS", "deep", "cached"])
@pytest.mark.parametrize("generation", [2, 3])
def test_fast_dds_profiles_say_the_plan_with_names_of_the_schema(name, generation):
    """Best-effort topics have no times, those behind a cache no deadline; deep histories raise the limits."""
    plan = planned(name)
    found = profiles(fast_dds_xml(plan, generation=generation))
    assert len(found) == 2 * len(plan.topics)
    for part, kind in product(plan.topics, ("data_writer", "data_reader")):
        said = found[kind, part.topic.name]
        assert set("/".join(said).split("/")) <= NAMES.union(TIMES[generation])
        assert said["topic/historyQos/kind"] == "KEEP_LAST"
        assert int(said["topic/historyQos/depth"]) == part.depth
        limits = [int(said.get(f"topic/resourceLimitsQos/{name}", 0)) for name in LIMITS]
        assert limits == ([part.depth, 1, part.depth] if part.depth > 400 else [0, 0, 0])
        assert said["qos/reliability/kind"] == part.topic.reliability.name
        assert ("times" in said) == part.topic.reliable
        assert ("qos/deadline" in said) == (not part.topic.cached)
        if not part.topic.cached:
            deadline_ns = int(said["qos/deadline/period/sec"]) * 10**9
            assert deadline_ns + int(said["qos/deadline/period/nanosec"]) == part.deadline_ns
    heartbeat_s = found["data_writer", "/robot1/lidar"].get(f"times/{TIMES[generation][0]}/sec")
    assert heartbeat_s == ("3" if name != "cached" else None)


@pytest.mark.parametrize(
    ("export", "name", "message"),
    [
        (partial(fast_dds_xml, generation=1), "Fast DDS", "given 1, allowed: 2 and 3"),
        (fast_dds_xml, "Cyclone DDS", r"given 'Cyclone DDS', .* the timing of Fast DDS"),
        (cyclone_xml, "Fast DDS", r"given 'Fast DDS', .* the timing of Cyclone DDS"),
    ],
)
def test_an_unknown_generation_and_a_plan_for_another_vendor_are_refused(export, name, message):
    with pytest.raises(InvalidValueError, match=message):
        export(planned(name))


def run_cyclone(path: Path, text: str) -> subprocess.CompletedProcess[str]:
    path.write_text(text)
    code = "import sys; from cyclonedds.domain import Domain; Domain(231, open(sys.argv[1]).read())"
    command = [sys.executable, "-c", code, str(path)]
    return subprocess.run(command, capture_output=True, text=True, timeout=20, check=False)


def test_cyclone_dds_itself_accepts_its_configuration_which_has_the_planned_timing(tmp_path):
    text = cyclone_xml(planned("Cyclone DDS"))
    done = run_cyclone(tmp_path / "good.xml", text)
    assert (done.returncode, done.stderr) == (0, "")
    bad = run_cyclone(tmp_path / "bad.xml", text.replace("NackDelay", "NackDelays"))
    assert bad.returncode != 0, "Cyclone would notice what it does not know"
    internal = ET.fromstring(text).find("*/{*}Internal")  # noqa: S314 - our own text
    assert texts(internal) == {
        "HeartbeatInterval": "100 ms",
        "NackDelay": "10 ms",
        "AckDelay": "10 ms",
    }
    assert internal[0].attrib == {"min": "5 ms", "minsched": "20 ms", "max": "8000 ms"}


def test_no_least_interval_of_cyclone_dds_is_above_the_heartbeat():
    vendor = replace(CYCLONE_DDS, heartbeat_ns=3_000_000)
    text = cyclone_xml(replace(planned("Cyclone DDS"), vendor=vendor))
    interval = ET.fromstring(text).find("*/{*}Internal/{*}HeartbeatInterval")  # noqa: S314 - our own text
    assert (interval.text, interval.get("min"), interval.get("minsched")) == ("3 ms",) * 3


def test_hyphens_in_a_name_of_a_topic_leave_the_xml_valid():
    plan = planned("cached")
    part = replace(plan.topics[0], topic=replace(plan.topics[0].topic, name="/a---b-"))
    text = fast_dds_xml(replace(plan, topics=(part,)))
    assert ("data_writer", "/a---b-") in profiles(text)


@pytest.mark.parametrize("name", PLANS)
def test_the_ros_2_file_has_overrides_of_both_sides_and_names_the_rates(name):
    plan = planned(name)
    text = ros2_parameters(plan)
    expected = {}
    for part in plan.topics:
        policies = {
            "reliability": part.topic.reliability.value,
            "durability": part.topic.durability.value,
            "history": "keep_last",
            "depth": part.depth,
        }
        if not part.topic.cached:
            policies["deadline"] = part.deadline_ns
        expected[part.topic.name] = {"publisher": policies, "subscription": policies}
        assert f"#   {part.topic.name}: {part.rate_hz:.4g} Hz" in text
    assert yaml.safe_load(text) == {"/**": {"ros__parameters": {"qos_overrides": expected}}}
    assert "&id" not in text, "rcl's parser knows no anchors"
