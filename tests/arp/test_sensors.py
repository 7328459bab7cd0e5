"""Paper B, Table 1 and section 3.1: the sensors, their sizes, and whose they are."""

from __future__ import annotations

import pytest

from sfglab.arp.robots import ROBOTS, SENSORS, cdr_bytes, object_bytes


@pytest.mark.parametrize("sensor", SENSORS.values(), ids=SENSORS)
def test_table_1_gives_the_sizes_of_python_objects(sensor):
    assert object_bytes(sensor) == sensor.table_bytes


def test_what_travels_is_smaller():
    sizes = {name: cdr_bytes(sensor) for name, sensor in SENSORS.items()}
    assert sizes == dict.fromkeys(("lidar", "flame", "dht11", "imu", "ultrasonic"), 8) | {
        "pir": 20,
        "light": 16,
    }


def test_three_robots_have_sixteen_sensors():
    assert [len(sensors) for sensors in ROBOTS.values()] == [6, 5, 5]
    assert {name for sensors in ROBOTS.values() for name in sensors} == set(SENSORS)
