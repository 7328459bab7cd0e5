"""Paper B, Table 1 and section 3.1: the sensors of each robot, and what a message of each is."""

import pytest

from sfglab.arp.robots import ROBOTS, SENSORS, cdr_bytes, object_bytes
from sfglab.lab.experiments.balancing.results import TABLE_1


def test_robots_have_the_sensors_of_section_3_1():
    """Robot 1 has six; robots 2 and 3 have the same five."""
    common = {"flame", "pir", "dht11", "light"}
    assert set(ROBOTS["robot1"]) == common | {"lidar", "imu"}
    assert set(ROBOTS["robot2"]) == set(ROBOTS["robot3"]) == common | {"ultrasonic"}
    assert [len(sensors) for sensors in ROBOTS.values()] == [6, 5, 5]


def test_types_and_sizes_are_table_1_s():
    assert {s.name: (s.type, s.table_bytes) for s in SENSORS.values()} == TABLE_1
    assert {s.name: (s.type, object_bytes(s)) for s in SENSORS.values()} == TABLE_1


@pytest.mark.parametrize("name", SENSORS)
def test_a_message_has_the_size_of_its_cdr(name):
    """A header of 4 bytes, then a number, a byte, or length and text with its end, in whole words."""
    expected = {"pir": 4 + 16, "light": 4 + 12}
    assert cdr_bytes(SENSORS[name]) == expected.get(name, 8)
