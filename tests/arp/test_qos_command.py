"""`sfglab qos`: what the command prints and writes; `test_mistakes.py` has how it refuses."""

import json
import re
from functools import partial
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
import yaml
from commands import called

DATA = Path(__file__).parents[2] / "data" / "qos"
PAPER_B, WAREHOUSE = str(DATA / "paper_b.yaml"), str(DATA / "warehouse.yaml")
call = partial(called, "qos")


def test_the_table_has_a_line_for_each_topic_and_the_printed_method_gives_all_the_same():
    text = call(PAPER_B)
    assert len(re.findall(r"^/\S+ +\d+\.\d\d +\d+ ", text, re.MULTILINE)) == 18
    assert re.search(r"channel utilisation \d\d %", text)
    text = call(PAPER_B, "--method", "paper", "--rate-max", "1000")
    assert text.count(" 165.67    827 ") == 18
    assert "overloaded" in text
    assert "without bound" in text


def test_no_topic_is_faster_than_rate_max_and_a_higher_price_of_latency_takes_less():
    rates = re.findall(r"^/\S+ +(\d+\.\d\d)", call(PAPER_B, "--rate-max", "20"), re.MULTILINE)
    assert max(map(float, rates)) == 20
    dear, cheap = (
        call(PAPER_B, "--vendor", "cyclone_dds", "--latency-weight", price)
        for price in ("500", "1")
    )
    assert int(re.search(r"utilisation (\d+) %", dear)[1]) < int(
        re.search(r"utilisation (\d+) %", cheap)[1]
    )


def test_the_front_has_a_line_for_each_price():
    warning, *lines = call(WAREHOUSE, "--pareto").splitlines()
    assert warning.startswith("warning: samples above one frame")
    assert len(lines) == 14
    latencies = [float(line.split()[2]) for line in lines[1:]]
    assert latencies == sorted(latencies, reverse=True)


def test_files_are_written_into_a_folder_and_named(tmp_path):
    out = str(tmp_path / "new" / "config")
    for name, file, given in (
        ("fastdds", "fastdds.xml", PAPER_B),
        ("fastdds3", "fastdds3.xml", PAPER_B),
        ("cyclone", "cyclonedds.xml", WAREHOUSE),
        ("ros2", "qos_overrides.yaml", WAREHOUSE),
        ("table", "qos.txt", WAREHOUSE),
    ):
        assert call(given, "--format", name, "--out", out).strip().endswith(file)
    folder = Path(out)
    assert len(list(folder.iterdir())) == 5
    ET.fromstring((folder / "fastdds.xml").read_text())  # noqa: S314 - our own text
    assert "/**" in yaml.safe_load((folder / "qos_overrides.yaml").read_text())


def test_another_vendor_can_be_planned_for():
    assert "<CycloneDDS" in call(PAPER_B, "--vendor", "cyclone_dds", "--format", "cyclone")
    assert "<NackDelay>10 ms<" in call(WAREHOUSE, "--vendor", "cyclone_dds", "--format", "cyclone")


@pytest.mark.parametrize(
    ("rmw", "named", "depth", "said"),
    [
        ("fastrtps-async", "Fast DDS, asynchronous", 6, "PUBLICATION_MODE=ASYNCHRONOUS"),
        ("fastrtps-sync", "Fast DDS, synchronous", 4, "PUBLICATION_MODE=SYNCHRONOUS"),
        ("cyclone", "Cyclone DDS", 16, None),
    ],
)
def test_what_is_recommended_follows_what_ros_2_runs_on(rmw, named, depth, said):
    text = call(PAPER_B, "--rmw", rmw)
    assert f"{named}, 20 Mbit/s" in text
    assert int(re.search(r"^/hello +\S+ +(\d+)", text, re.MULTILINE)[1]) == depth
    if said:
        assert said in call(PAPER_B, "--rmw", rmw, "--format", "fastdds")


def test_json_has_the_deadlines_and_no_number_that_json_has_not():
    def refuse(constant):
        raise AssertionError(constant)

    text = call(PAPER_B, "--method", "paper", "--json")
    plan = json.loads(text[text.index("{") :], parse_constant=refuse)
    assert plan["latency_s"] is None, "the channel is overloaded"
    assert plan["method"] == "paper"
    deadlines_ns = [part["deadline_ns"] for part in plan["topics"]]
    lengths_s = [part["depth"] / part["rate_hz"] for part in plan["topics"]]
    assert deadlines_ns == pytest.approx([1e9 * length for length in lengths_s])


@pytest.mark.parametrize(
    ("link", "topic", "options", "warned"),
    [
        ("{}", "size_bytes: 1380", [], None),
        ("{}", "size_bytes: 1400", [], "IP fragments (Cyclone DDS has its own): /a"),
        ("{loss: 0.2}", "size_bytes: 8", [], "losses up to 10%: /a"),
        ("{}", "size_bytes: 8, rate_min_hz: 9", ["--rate-max", "5"], "file's rate_min_hz: /a"),
        ("{}", "size_bytes: 8, rate_max_hz: 9", ["--rate-max", "5"], None),
        ("{}", "size_bytes: 8, rate_min_hz: 600", ["--method", "paper"], "or rate_max_hz: /a"),
    ],
)
def test_a_warning_names_topics_beyond_the_model_or_the_limits_of_their_file(
    link, topic, options, warned, tmp_path
):
    file = tmp_path / "topics.yaml"
    quiet = "/b: {from: robot, to: station, size_bytes: 8}"
    file.write_text(
        f"link: {link}\ntopics:\n  /a: {{from: robot, to: station, {topic}}}\n  {quiet}\n"
    )
    text = call(str(file), *options)
    found = re.findall(r"^warning: .*$", text, re.MULTILINE)
    assert len(found) == (warned is not None)
    assert (warned or "") in "".join(found)
