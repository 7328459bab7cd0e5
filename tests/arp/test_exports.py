"""Exported QoS: what each file says is the plan, and those who read such files accept it."""

import re
import subprocess
import sys
from dataclasses import replace
from functools import cache
from itertools import product
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
import yaml

from sfglab.arp import load_topics, plan_as_printed, plan_file
from sfglab.arp.exports import EXPORTS, cyclone_xml, fast_dds_xml, ros2_parameters
from sfglab.errors import InvalidValueError
from sfglab.qos import Reliability
from sfglab.rtps import CYCLONE_DDS

DATA = Path(__file__).parents[2] / "data" / "qos"
PAPER_B = load_topics(DATA / "paper_b.yaml")


# Elements of what we write, in the schemas that Fast DDS ships (resources/xsd: generation 2,
# fastRTPS_profiles.xsd; generation 3, fastdds_profiles.xsd).
NAMES = {
    *("topic", "qos", "times", "historyMemoryPolicy", "historyQos", "kind", "depth"),
    *("resourceLimitsQos", "max_samples", "max_instances", "max_samples_per_instance"),
    *("deadline", "durability", "reliability", "period", "sec", "nanosec"),
}
LIMITS = ("max_samples", "max_instances", "max_samples_per_instance")
TIMES = {
    2: ("heartbeatPeriod", "nackResponseDelay", "heartbeatResponseDelay"),
    3: ("heartbeat_period", "nack_response_delay", "heartbeat_response_delay"),
}
FORMATS = {2: "fastdds", 3: "fastdds3"}


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


def parsed(text: str) -> ET.Element:
    """Return the root of an XML text, its elements without their namespace."""
    return ET.fromstring(re.sub(' xmlns="[^"]+"', "", text))  # noqa: S314 - our own text


@pytest.mark.parametrize("name", ["Fast DDS", "deep", "cached"])
@pytest.mark.parametrize("generation", [2, 3])
def test_fast_dds_profiles_say_the_plan_with_names_of_the_schema(name, generation):
    """Best-effort topics have no times, those behind a cache no deadline; deep histories raise the limits."""
    plan = planned(name)
    found = parsed(EXPORTS[FORMATS[generation]].text(plan)).find("profiles")
    assert len(found.findall("*")) == 2 * len(plan.topics)
    heartbeat, *_ = TIMES[generation]
    for part, kind in product(plan.topics, ("data_writer", "data_reader")):
        profile = found.find(f"{kind}[@profile_name='{part.topic.name}']")
        assert {e.tag for e in profile.iter()} <= NAMES.union(TIMES[generation], [kind])
        text = profile.findtext
        assert text("topic/historyQos/kind") == "KEEP_LAST"
        assert text("topic/historyQos/depth") == str(part.depth)
        limits = [int(text(f"topic/resourceLimitsQos/{name}", "0")) for name in LIMITS]
        assert limits == ([part.depth, 1, part.depth] if part.depth > 400 else [0, 0, 0])
        assert text("qos/reliability/kind") == part.topic.reliability.name
        seconds, rest = (text(f"qos/deadline/period/{name}", "0") for name in ("sec", "nanosec"))
        assert int(seconds) * 10**9 + int(rest) == (part.deadline_ns or 0)
        expected = "3" if part.topic.reliable and kind == "data_writer" else None
        assert text(f"times/{heartbeat}/sec") == expected


def test_a_plan_for_another_vendor_is_refused():
    with pytest.raises(
        InvalidValueError, match=r"given 'Fast DDS.*', .* the timing of Cyclone DDS"
    ):
        EXPORTS["cyclone"].text(planned("Fast DDS"))
    with pytest.raises(InvalidValueError, match=r"given 'Cyclone DDS', .* the timing of Fast DDS"):
        EXPORTS["fastdds"].text(planned("Cyclone DDS"))


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
    interval, *delays = parsed(text).find("Domain/Internal")
    assert [element.text for element in (interval, *delays)] == ["100 ms", "10 ms", "10 ms"]
    assert interval.attrib == {"min": "5 ms", "minsched": "20 ms", "max": "8000 ms"}


def test_no_least_interval_of_cyclone_dds_is_above_the_heartbeat():
    vendor = replace(CYCLONE_DDS, heartbeat_ns=3_000_000)
    text = cyclone_xml(replace(planned("Cyclone DDS"), vendor=vendor))
    interval = parsed(text).find("Domain/Internal/HeartbeatInterval")
    assert (interval.text, interval.get("min"), interval.get("minsched")) == ("3 ms",) * 3


def test_hyphens_in_a_name_of_a_topic_leave_the_xml_valid():
    [part] = planned("cached").topics
    part = replace(part, topic=replace(part.topic, name="/a---b-"))
    text = fast_dds_xml(replace(planned("cached"), topics=(part,)))
    assert parsed(text).find("profiles/data_writer").get("profile_name") == "/a---b-"


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
