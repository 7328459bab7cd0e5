"""Paper B, Table 1 and section 3.1: the sensors of each robot, and what a message of each is."""

import pytest

from sfglab.arp.robots import ROBOTS, SENSORS, cdr_bytes, object_bytes
from sfglab.lab.experiments.balancing.results import TABLE_1

TEXT = "std_msgs/msg/String"
SHARED = {"flame", "pir", "dht11", "light"}


def test_the_sensors_are_table_1_s():
    assert SENSORS.keys() == TABLE_1.keys()


@pytest.mark.parametrize("name", TABLE_1)
def test_types_and_sizes_are_table_1_s(name):
    sensor = SENSORS[name]
    assert (sensor.type, sensor.table_bytes) == TABLE_1[name]
    assert (sensor.type, object_bytes(sensor)) == TABLE_1[name]


@pytest.mark.parametrize("name", SENSORS)
def test_a_message_has_the_size_of_its_cdr(name):
    """A header of 4 bytes, then a number, a byte, or length and text with its end, in whole words."""
    sensor = SENSORS[name]
    padded = 8
    if sensor.type == TEXT:
        padded = (4 + 4 + len(str(sensor.example)) + 1 + 3) // 4 * 4
    assert cdr_bytes(sensor) == padded


def test_each_robot_has_the_sensors_of_section_3_1_once():
    robots = dict.fromkeys(("robot2", "robot3"), SHARED | {"ultrasonic"})
    robots["robot1"] = SHARED | {"lidar", "imu"}
    assert {name: set(sensors) for name, sensors in ROBOTS.items()} == robots
    assert all(len(set(sensors)) == len(sensors) for sensors in ROBOTS.values())
