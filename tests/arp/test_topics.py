"""Files of topics: what they say, what they may leave out, and how each mistake is named."""

from dataclasses import replace
from pathlib import Path

import pytest

from sfglab.arp.robots import ROBOTS, SENSORS
from sfglab.arp.topics import Topic, load_topics, read_topics
from sfglab.documents import Document, DocumentError
from sfglab.errors import InvalidValueError
from sfglab.rtps import FAST_DDS, Medium

DATA = Path(__file__).parents[2] / "data" / "qos"
ONE = "topics:\n  /a: {from: robot, to: station, size_bytes: 8}\n"


def read(text):
    return read_topics(Document(text, "t.yaml"))


def test_paper_bs_file_has_table_1s_sensors_hello_the_localisation_result_and_the_models_usual_link():
    given = load_topics(DATA / "paper_b.yaml")
    found = {topic.name: topic for topic in given.topics}
    for robot, names in ROBOTS.items():
        for name in names:
            topic, sensor = found.pop(f"/{robot}/{name}"), SENSORS[name]
            assert (topic.source, topic.target) == (robot, "station")
            assert (topic.size_bytes, topic.change_s) == (sensor.table_bytes, sensor.change_s)
    assert list(found) == ["/hello", "/robot3/localisation"]
    assert (given.medium, given.vendor, given.agents) == (Medium(), FAST_DDS, tuple(ROBOTS))


def test_what_a_file_leaves_out_has_the_usual_value():
    given = read(ONE)
    assert given.topics == (Topic(name="/a", source="robot", target="station", size_bytes=8),)
    assert (given.medium, given.vendor, given.agents) == (Medium(), FAST_DDS, ("robot",))
    vendor = read(f"timing: {{heartbeat_ms: 50}}\n{ONE}").vendor
    assert vendor == replace(FAST_DDS, heartbeat_ns=50_000_000)


def line(text: str) -> str:
    return f"topics:\n  /a: {{{text}}}\n"


MISTAKES = [  # beside what `test_documents.py` has for every file
    ("topics: {}", r"topics: given \{\}, allowed: at least one topic"),
    (
        "topics: {a: {from: r, to: s, size_bytes: 8}}",
        r"topics\.a: given 'a', allowed: a full topic name",
    ),
    (r'topics: {"/a\nb": {from: r, to: s, size_bytes: 8}}', "allowed: a full topic name"),
    (line("from: r, to: r, size_bytes: 8"), r"topics\./a\.to: given 'r', allowed: another host"),
    (
        line("from: r, to: [s, s], size_bytes: 8"),
        r"/a\.to: given \['s', 's'\], allowed: another .*each once",
    ),
    (
        line("from: r, to: {s: 1}, size_bytes: 8"),
        r"/a\.to: given .*, allowed: a text or a list",
    ),
    (
        line("from: r, to: s, size_bytes: 8, rate_min_hz: 9, rate_max_hz: 5"),
        r"/a\.rate_min_hz: given 9, allowed: up to the topic's rate_max_hz, 5",
    ),
    (
        f"agents: [moon]\n{ONE}",
        r"agents: given \['moon'\], allowed: a list of hosts among robot, station",
    ),
    (f"agents: [robot, robot]\n{ONE}", r"agents: given \['robot', 'robot'\], .*each once"),
    (
        line("from: r, to: s, size_bytes: 8, rate_max_hz: 1e-300"),
        "given '1e-300', .*a finite number from 1e-09 to 1000000000; .*as in 1.0e-9",
    ),
]


@pytest.mark.parametrize(("text", "message"), MISTAKES)
def test_each_mistake_is_named_by_file_topic_and_key(text, message):
    with pytest.raises(DocumentError, match=message):
        read(text)


@pytest.mark.parametrize("medium", [Medium(shared=False), Medium(access_point=True)])
def test_a_medium_that_no_plan_is_for_is_refused(medium):
    with pytest.raises(InvalidValueError, match="allowed: a shared medium without an access point"):
        replace(read(ONE), medium=medium)
