"""`sfglab qos`: what the command prints and writes; `test_mistakes.py` has how it refuses."""

import json
import re
from functools import partial
from pathlib import Path

import pytest
from commands import called

DATA = Path(__file__).parents[2] / "data" / "qos"
PAPER_B, WAREHOUSE = str(DATA / "paper_b.yaml"), str(DATA / "warehouse.yaml")
call = partial(called, "qos")


def test_the_table_has_a_line_for_each_topic_none_faster_than_rate_max_as_printed_all_the_same():
    rates = re.findall(r"^/\S+ +(\d+\.\d\d) +\d+ ", call(PAPER_B, "--rate-max", "20"), re.MULTILINE)
    assert len(rates) == 18
    assert max(map(float, rates)) == 20
    text = call(PAPER_B, "--method", "paper", "--rate-max", "1000")
    assert text.count(" 165.67    827 ") == 18
    assert "overloaded" in text
    assert "without bound" in text


def test_a_plan_is_for_the_files_link_and_timing():
    text = call(WAREHOUSE)
    assert "Cyclone DDS, 12 Mbit/s, 5 % loss" in text
    assert re.search(r"^/picker/goal +\S+ +\d+ +none ", text, re.MULTILINE), "it is cached"
    assert "<NackDelay>10 ms<" in call(WAREHOUSE, "--rmw", "cyclone", "--format", "cyclone")


@pytest.mark.parametrize(
    ("rmw", "named", "depth", "format_", "said"),
    [
        ("fastrtps-async", "Fast DDS 2.4 to 3.2, asynchronous", 6, "fastdds", "MODE=ASYNCHRONOUS"),
        ("fastrtps-sync", "Fast DDS 2.4 to 3.2, synchronous", 4, "fastdds", "MODE=SYNCHRONOUS"),
        ("cyclone", "Cyclone DDS", 16, "cyclone", "<CycloneDDS"),
    ],
)
def test_what_is_recommended_follows_what_ros_2_runs_on(rmw, named, depth, format_, said):
    text = call(PAPER_B, "--rmw", rmw)
    assert f"{named}, 20 Mbit/s" in text
    assert int(re.search(r"^/hello +\S+ +(\d+)", text, re.MULTILINE)[1]) == depth
    assert said in call(PAPER_B, "--rmw", rmw, "--format", format_)


def test_the_front_has_a_line_for_each_latency_weight():
    warning, _, *lines = call(WAREHOUSE, "--pareto").splitlines()
    assert warning.startswith("warning: samples above one frame")
    assert [len(line.split()) for line in lines] == [5] * 13


def test_json_has_the_deadlines_and_no_number_that_json_has_not():
    def read(*options):
        text = call(PAPER_B, *options, "--json")
        return json.loads(text[text.index("{") :], parse_constant=pytest.fail)

    assert read("--latency-weight", "5")["latency_price_hz"] == 5
    plan = read("--method", "paper")
    assert plan["latency_s"] is None, "the channel is overloaded"
    for part in plan["topics"]:
        assert part["deadline_ns"] == pytest.approx(1e9 * part["depth"] / part["rate_hz"])


@pytest.mark.parametrize(
    ("loss", "topic", "options", "warned"),
    [
        (0.01, "size_bytes: 1400", [], "IP fragments (Cyclone DDS has its own): /a"),
        (0.2, "size_bytes: 8", [], "losses up to 10%: /a, /b"),
        (0.01, "size_bytes: 8, rate_min_hz: 9", ["--rate-max", "5"], "file's rate_min_hz: /a"),
        (0.01, "size_bytes: 8, rate_min_hz: 600", ["--method", "paper"], "or rate_max_hz: /a"),
    ],
)
def test_a_warning_names_topics_beyond_the_model_or_the_limits_of_their_file(
    loss, topic, options, warned, tmp_path
):
    file = tmp_path / "topics.yaml"
    ends = "from: robot, to: station"
    topics = f"  /a: {{{ends}, {topic}}}\n  /b: {{{ends}, size_bytes: 8}}\n"
    file.write_text(f"link: {{loss: {loss}}}\ntopics:\n{topics}")
    found = re.findall(r"^warning: .*$", call(str(file), *options), re.MULTILINE)
    assert len(found) == 1
    assert warned in found[0]
