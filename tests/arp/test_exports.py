"""Exported QoS: what each file says is the plan, and those who read such files accept it."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
import yaml

from sfglab.arp import Topic, TopicFile
from sfglab.arp.exports import EXPORTS, cyclone_xml, fast_dds_xml, ros2_parameters
from sfglab.arp.plan import assess
from sfglab.errors import InvalidValueError
from sfglab.qos import Durability, Reliability
from sfglab.rtps import CYCLONE_DDS, FAST_DDS

# Elements as in the schemas that Fast DDS ships (resources/xsd: generation 2,
# fastRTPS_profiles.xsd; generation 3, fastdds_profiles.xsd). A history above 400 samples has limits.
WRITER = """
<data_writer profile_name="/a---b-">
  <topic>
    <historyQos><kind>KEEP_LAST</kind><depth>500</depth></historyQos>
    <resourceLimitsQos>
      <max_samples>500</max_samples>
      <max_instances>1</max_instances>
      <max_samples_per_instance>500</max_samples_per_instance>
    </resourceLimitsQos>
  </topic>
  <qos>
    <deadline><period><sec>12</sec><nanosec>500000000</nanosec></period></deadline>
    <durability><kind>VOLATILE</kind></durability>
    <reliability><kind>RELIABLE</kind></reliability>
  </qos>
  <times>
    <heartbeatPeriod><sec>3</sec><nanosec>0</nanosec></heartbeatPeriod>
    <nackResponseDelay><sec>0</sec><nanosec>5000000</nanosec></nackResponseDelay>
  </times>
  <historyMemoryPolicy>PREALLOCATED_WITH_REALLOC</historyMemoryPolicy>
</data_writer>
"""
READER_TIMES = """
<times><heartbeatResponseDelay><sec>0</sec><nanosec>5000000</nanosec></heartbeatResponseDelay></times>
"""
# Of a best-effort topic behind a local cache: no limits, no times and no deadline.
CACHED = """
<data_reader profile_name="/a---b-">
  <topic><historyQos><kind>KEEP_LAST</kind><depth>5</depth></historyQos></topic>
  <qos>
    <durability><kind>TRANSIENT_LOCAL</kind></durability>
    <reliability><kind>BEST_EFFORT</kind></reliability>
  </qos>
  <historyMemoryPolicy>PREALLOCATED_WITH_REALLOC</historyMemoryPolicy>
</data_reader>
"""
GENERATION_3 = {
    "heartbeatPeriod": "heartbeat_period",
    "nackResponseDelay": "nack_response_delay",
    "heartbeatResponseDelay": "heartbeat_response_delay",
}
CHANGES = {"cached": True, "reliability": Reliability.BEST_EFFORT}
CHANGES |= {"durability": Durability.TRANSIENT_LOCAL, "depth": 5}


def plan_of(*, vendor=FAST_DDS, depth=500, **values):
    """Return a plan of one topic at 40 Hz. Hyphens in its name must leave XML's comments valid."""
    topic = Topic(name="/a---b-", source="robot", target="station", size_bytes=24, **values)
    given = TopicFile(topics=(topic,), vendor=vendor)
    return assess(given, np.array([40.0]), np.array([depth]), method="by hand")


def found_in(text: str, path: str) -> str:
    """Return an element of an XML text without comments, spaces between elements and namespace."""
    root = ET.fromstring(text.replace(" xmlns=", " about="))  # noqa: S314 - our own text
    return plain(ET.tostring(root.find(path), "unicode"))


def plain(xml: str) -> str:
    return ET.canonicalize(xml, strip_text=True)


@pytest.mark.parametrize(("format_", "names"), [("fastdds", {}), ("fastdds3", GENERATION_3)])
def test_fast_dds_profiles_say_the_plan_with_names_of_the_schema(format_, names):
    text = EXPORTS[format_].text(plan_of())
    for old, new in names.items():
        assert old not in text
        text = text.replace(new, old)
    assert found_in(text, "profiles/data_writer") == plain(WRITER)
    assert found_in(text, "profiles/data_reader/times") == plain(READER_TIMES)


def test_a_best_effort_topic_has_no_times_and_one_behind_a_cache_no_deadline():
    text = fast_dds_xml(plan_of(**CHANGES))
    assert found_in(text, "profiles/data_reader") == plain(CACHED)


@pytest.mark.parametrize(("format_", "vendor"), [("cyclone", FAST_DDS), ("fastdds", CYCLONE_DDS)])
def test_a_plan_for_another_vendor_is_refused(format_, vendor):
    with pytest.raises(InvalidValueError, match=f"given '{vendor.name}', .* the timing of "):
        EXPORTS[format_].text(plan_of(vendor=vendor))


def run_cyclone(path: Path, text: str) -> subprocess.CompletedProcess[str]:
    path.write_text(text)
    code = "import sys; from cyclonedds.domain import Domain; Domain(231, open(sys.argv[1]).read())"
    command = [sys.executable, "-c", code, str(path)]
    return subprocess.run(command, capture_output=True, text=True, timeout=20, check=False)


def test_cyclone_dds_itself_accepts_its_configuration(tmp_path):
    text = cyclone_xml(plan_of(vendor=CYCLONE_DDS))
    done = run_cyclone(tmp_path / "good.xml", text)
    assert (done.returncode, done.stderr) == (0, "")
    bad = run_cyclone(tmp_path / "bad.xml", text.replace("NackDelay", "NackDelays"))
    assert bad.returncode != 0, "Cyclone would notice what it does not know"


@pytest.mark.parametrize(
    ("heartbeat_ms", "least"),
    [
        (100, 'max="8000 ms" min="5 ms" minsched="20 ms"'),
        (3, 'max="8000 ms" min="3 ms" minsched="3 ms"'),
    ],
)
def test_cyclone_dds_has_the_timing_and_no_least_interval_above_the_heartbeat(heartbeat_ms, least):
    vendor = replace(CYCLONE_DDS, heartbeat_ns=heartbeat_ms * 10**6)
    assert found_in(cyclone_xml(plan_of(vendor=vendor)), "Domain/Internal") == (
        f"<Internal><HeartbeatInterval {least}>{heartbeat_ms} ms</HeartbeatInterval>"
        "<NackDelay>100 ms</NackDelay><AckDelay>10 ms</AckDelay></Internal>"
    )


RELIABLE = """
{reliability: reliable, durability: volatile, history: keep_last, depth: 500, deadline: 12500000000}
"""
# Not sooner than after two periods.
SHALLOW = """
{reliability: reliable, durability: volatile, history: keep_last, depth: 1, deadline: 50000000}
"""
BEST_EFFORT = """
{reliability: best_effort, durability: transient_local, history: keep_last, depth: 5}
"""


@pytest.mark.parametrize(
    ("changes", "policies"), [({}, RELIABLE), ({"depth": 1}, SHALLOW), (CHANGES, BEST_EFFORT)]
)
def test_the_ros_2_file_has_overrides_of_both_sides_and_names_the_rates(changes, policies):
    text = ros2_parameters(plan_of(**changes))
    sides = dict.fromkeys(("publisher", "subscription"), yaml.safe_load(policies))
    expected = {"/**": {"ros__parameters": {"qos_overrides": {"/a---b-": sides}}}}
    assert yaml.safe_load(text) == expected
    assert "#   /a---b-: 40 Hz" in text
    assert "&id" not in text, "rcl's parser knows no anchors"
