"""Exported QoS: what each file says is the plan, and those who read such files accept it."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
import yaml

from sfglab.arp import load_topics, plan_as_printed, plan_file
from sfglab.arp.exports import cyclone_xml, fast_dds_xml, ros2_parameters
from sfglab.errors import InvalidValueError
from sfglab.qos import Reliability

DATA = Path(__file__).parents[2] / "data" / "qos"
PAPER_B = load_topics(DATA / "paper_b.yaml")
WAREHOUSE = load_topics(DATA / "warehouse.yaml")


# Elements of what we write, in the schemas that Fast DDS ships (resources/xsd: generation 2,
# fastRTPS_profiles.xsd; generation 3, fastdds_profiles.xsd).
NAMES = {
    "dds",
    "profiles",
    "data_writer",
    "data_reader",
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
TIMES = {
    2: {"heartbeatPeriod", "nackResponseDelay", "heartbeatResponseDelay"},
    3: {"heartbeat_period", "nack_response_delay", "heartbeat_response_delay"},
}


@pytest.fixture(scope="module")
def fast():
    return plan_file(PAPER_B)


@pytest.fixture(scope="module")
def cyclone():
    return plan_file(WAREHOUSE)


def local(element: ET.Element) -> str:
    return element.tag.rpartition("}")[2]


def profiles(text: str) -> dict[tuple[str, str], ET.Element]:
    top = next(iter(ET.fromstring(text)))  # noqa: S314 - our own text
    return {(local(p), p.get("profile_name", "")): p for p in top}


def leaves(element: ET.Element) -> dict[str, str]:
    """Return a profile's texts by path."""
    found = {}
    for inner in element:
        below = leaves(inner)
        found |= {f"{local(inner)}/{k}": v for k, v in below.items()} or {
            local(inner): inner.text or ""
        }
    return found


@pytest.mark.parametrize("generation", [2, 3])
def test_fast_dds_profiles_say_the_plan_with_names_of_the_schema(fast, generation):
    text = fast_dds_xml(fast, generation=generation)
    elements = ET.fromstring(text).iter()  # noqa: S314 - our own text
    assert {local(element) for element in elements} <= NAMES | TIMES[generation]
    found = profiles(text)
    assert len(found) == 2 * len(fast.topics)
    for part in fast.topics:
        for kind in ("data_writer", "data_reader"):
            said = leaves(found[kind, part.topic.name])
            assert said["topic/historyQos/kind"] == "KEEP_LAST"
            assert int(said["topic/historyQos/depth"]) == part.depth
            assert said["qos/reliability/kind"] == "RELIABLE"
            deadline_ns = int(said["qos/deadline/period/sec"]) * 10**9
            assert deadline_ns + int(said["qos/deadline/period/nanosec"]) == part.deadline_ns
        heartbeat = "heartbeatPeriod" if generation == 2 else "heartbeat_period"
        assert leaves(found["data_writer", part.topic.name])[f"times/{heartbeat}/sec"] == "3"


def test_best_effort_profiles_have_no_times():
    topics = (replace(PAPER_B.topics[0], reliability=Reliability.BEST_EFFORT),)
    for profile in profiles(fast_dds_xml(plan_file(replace(PAPER_B, topics=topics)))).values():
        assert not any(path.startswith("times") for path in leaves(profile))
        assert leaves(profile)["qos/reliability/kind"] == "BEST_EFFORT"


def test_topics_behind_a_cache_have_no_deadline():
    cached = plan_file(
        replace(PAPER_B, topics=tuple(replace(t, cached=True) for t in PAPER_B.topics))
    )
    assert "deadline" not in ros2_parameters(cached).partition("/**:")[2]
    assert not any(
        "deadline" in p for x in profiles(fast_dds_xml(cached)).values() for p in leaves(x)
    )


def test_a_history_beyond_fast_dds_limits_raises_them():
    said = leaves(
        profiles(fast_dds_xml(plan_as_printed(PAPER_B.limited_to(500))))["data_writer", "/hello"]
    )
    depth = int(said["topic/historyQos/depth"])
    limits = {k.rpartition("/")[2]: int(v) for k, v in said.items() if "resourceLimits" in k}
    assert depth > 400
    assert limits["max_samples_per_instance"] >= depth
    assert limits["max_samples"] >= limits["max_instances"] * limits["max_samples_per_instance"]


def test_an_unknown_generation_and_a_plan_for_another_vendor_are_refused(fast, cyclone):
    with pytest.raises(InvalidValueError, match="given 1, allowed: 2 and 3"):
        fast_dds_xml(fast, generation=1)
    with pytest.raises(InvalidValueError, match=r"given 'Cyclone DDS', .* the timing of Fast DDS"):
        fast_dds_xml(cyclone)
    with pytest.raises(InvalidValueError, match=r"given 'Fast DDS', .* the timing of Cyclone DDS"):
        cyclone_xml(fast)


def run_cyclone(path: Path) -> subprocess.CompletedProcess[str]:
    code = "import sys; from cyclonedds.domain import Domain; Domain(231, open(sys.argv[1]).read())"
    command = [sys.executable, "-c", code, str(path)]
    return subprocess.run(command, capture_output=True, text=True, timeout=20, check=False)


def test_cyclone_dds_itself_accepts_its_configuration_which_has_the_planned_timing(
    cyclone, tmp_path
):
    good, bad = tmp_path / "good.xml", tmp_path / "bad.xml"
    good.write_text(cyclone_xml(cyclone))
    bad.write_text(cyclone_xml(cyclone).replace("NackDelay", "NackDelays"))
    assert run_cyclone(good).returncode == 0, run_cyclone(good).stderr
    assert run_cyclone(good).stderr == ""
    assert run_cyclone(bad).returncode != 0, "Cyclone would notice what it does not know"
    root = ET.fromstring(cyclone_xml(cyclone))  # noqa: S314 - our own text
    said = {local(e): (e.text, e.attrib) for e in root.iter() if e.text and e.text.strip()}
    assert said["NackDelay"][0] == said["AckDelay"][0] == "10 ms"
    assert said["HeartbeatInterval"] == (
        "100 ms",
        {"min": "5 ms", "minsched": "20 ms", "max": "8000 ms"},
    )


def test_the_ros_2_file_is_a_parameter_file_with_overrides_of_both_sides_and_names_the_rates(
    cyclone, fast
):
    text = ros2_parameters(cyclone)
    overrides = yaml.safe_load(text)["/**"]["ros__parameters"]["qos_overrides"]
    assert list(overrides) == [part.topic.name for part in cyclone.topics]
    for part in cyclone.topics:
        sides = overrides[part.topic.name]
        deadline = {} if part.deadline_ns is None else {"deadline": part.deadline_ns}
        policies = {
            "reliability": part.topic.reliability.value,
            "durability": part.topic.durability.value,
            "history": "keep_last",
            "depth": part.depth,
        }
        assert sides == {"publisher": policies | deadline, "subscription": policies | deadline}
    assert "&" not in text, "rcl's parser knows no anchors"
    assert "*id" not in text
    text = ros2_parameters(fast)
    assert f"#   /hello: {fast['/hello'].rate_hz:.4g} Hz" in text
