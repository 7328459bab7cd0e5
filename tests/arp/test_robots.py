"""Paper B, Table 1 and section 3.1: the sensors of each robot, and what a message of each is."""

from sfglab.arp.robots import ROBOTS, SENSORS, object_bytes
from sfglab.lab.experiments.balancing.results import TABLE_1


def test_robots_have_the_sensors_of_section_3_1():
    """Robot 1 has six; robots 2 and 3 have the same five."""
    common = {"flame", "pir", "dht11", "light"}
    five = common | {"ultrasonic"}
    assert [set(sensors) for sensors in ROBOTS.values()] == [common | {"lidar", "imu"}, five, five]


def test_types_and_sizes_are_table_1_s():
    assert {s.name: (s.type, object_bytes(s)) for s in SENSORS.values()} == TABLE_1
