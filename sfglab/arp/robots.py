"""The module `robots` has paper B's robots: the sensors of Table 1, the seven methods, and the options of Table 2.

Table 1 has the sizes of the values as Python objects, as `sys.getsizeof` returns these sizes: 24 bytes for a float, 28
for a truth value, 49 plus one per letter for a text. On the wire the same values travel as CDR, with header and
padding: a float and a truth value take 8 bytes each, and the two texts take 20 and 16 bytes. The module `robots` has
the sizes of Python objects and the sizes of CDR.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import Annotated, Literal

from sfglab.fields import Bounds
from sfglab.messages import message_type, serialize
from sfglab.qos import QoSProfile
from sfglab.units import NS_PER_S


@dataclass(frozen=True, slots=True)
class Sensor:
    """A `Sensor` is one row of Table 1."""

    name: str  #: Name of the device in topics.
    type: str  #: ROS type of the sensor's messages.
    #: Example of a value that the sensor sends; of the paper's two texts, the text with Table 1's size.
    example: float | bool | str
    table_bytes: int  #: Size of the value in Table 1, bytes.
    #: Mean time between changes of the sensor's value, seconds, while objects move around the sensor.
    change_s: float


_FLOAT, _BOOL, _STRING = "std_msgs/msg/Float32", "std_msgs/msg/Bool", "std_msgs/msg/String"

_SENSORS = (
    # SLAMTEC A2M8: the LIDAR turns 10 times per second (data sheet), so one direction has 10 new ranges per second.
    Sensor("lidar", _FLOAT, 1.25, 24, 0.1),
    # AYNEF flame sensor module, a threshold switch: the project assumes that a flame or a lamp appears now and then.
    Sensor("flame", _BOOL, False, 28, 30.0),
    # HiLetgo DHT11: one reading per second in whole degrees (data sheet); a new value every ten seconds is assumed.
    Sensor("dht11", _FLOAT, 22.0, 24, 10.0),
    # HiLetgo MPU-6050: the IMU makes 1000 readings per second (data sheet), which all differ because of noise.
    Sensor("imu", _FLOAT, 0.02, 24, 0.001),
    # ELEGOO HC-SR04: one measurement takes 60 ms (data sheet).
    Sensor("ultrasonic", _FLOAT, 0.73, 24, 0.06),
    # HiLetgo HC-SR501: the sensor holds its output for 3 s or longer (data sheet).
    Sensor("pir", _STRING, "not detect", 59, 3.0),
    # VKLSVAN photosensitive sensor module, a threshold switch: a person who passes every ten seconds is assumed.
    Sensor("light", _STRING, "light", 54, 10.0),
)
SENSORS = {sensor.name: sensor for sensor in _SENSORS}
"""Sensors of paper B, Table 1, by name; section 3.1 has makers and models."""

ROBOTS = {
    "robot1": ("lidar", "light", "flame", "dht11", "imu", "pir"),
    "robot2": ("flame", "pir", "ultrasonic", "dht11", "light"),
    "robot3": ("flame", "pir", "ultrasonic", "dht11", "light"),
}
"""Names of the sensors of each robot: paper B, section 3.1."""


def object_bytes(sensor: Sensor) -> int:
    """Return the size of a sensor's value as a Python object, bytes; Table 1 has this size."""
    return sys.getsizeof(sensor.example)


def cdr_bytes(sensor: Sensor) -> int:
    """Return the size of a sensor's message on the wire, bytes: CDR with its 4-byte header, padded to whole words."""
    return len(serialize(message_type(sensor.type)(data=sensor.example)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Method:
    """A `Method` is one combination of local cache, cache control and QoS (paper B, sections 2.2 to 2.4)."""

    name: str  #: Name of the method, as in Fig. 10, 11 and 16.
    #: OPT: the rate comes from Eq. 6; with the depth ``opt`` the depth also comes from Eq. 6.
    optimised: bool = False
    local_cache: bool = False  #: LC: the robot suppresses repeated values.
    #: CC: the station discards repeated values before planning.
    cache_control: bool = False


METHODS = {
    method.name: method
    for method in (
        Method(name="none"),
        Method(name="OPT", optimised=True),
        Method(name="CC", cache_control=True),
        Method(name="LC", local_cache=True),
        Method(name="OPT+CC", optimised=True, cache_control=True),
        Method(name="OPT+LC", optimised=True, local_cache=True),
        Method(name="OPT+LC+CC", optimised=True, local_cache=True, cache_control=True),
    )
}
"""Methods of paper B, section 3, by name."""

BEST = "OPT+LC"  #: Method that by the paper has the lowest latency and loss and completes the lap.

MethodName = Literal["none", "OPT", "CC", "LC", "OPT+CC", "OPT+LC", "OPT+LC+CC"]
Rate = Annotated[int, Bounds(10, 1000)]  #: Value of Rmax, Hz.
Depth = Annotated[int, Bounds(1, 5000)]  #: Depth of a history, samples.
RATES_HZ = (100, 200, 500, 1000)  #: Values of Rmax: Table 2, DEADLINE.

#: Values of DEPTH in Table 2; the optimum of Eq. 6 is a further value.
DEPTHS = (1, 5, 10, 100, 1000, 5000)


def topic_qos(rate_hz: float, depth: int) -> QoSProfile:
    """Return the QoS of Table 2: RELIABLE, KEEP_LAST with a depth, and the period of a rate, Hz, as DEADLINE."""
    return QoSProfile(depth=depth, deadline_ns=round(NS_PER_S / rate_hz))


TAKE_S = 60e-6
"""Time for which a node of the station takes and compares a message: assumed, because the paper has no value."""

PLAN_S = 60e-6
"""Time of planning per value: assumed. `TAKE_S` and `PLAN_S` together are within the time of one callback of a ROS 2
executor on the computer of a station. `TAKE_S` and `PLAN_S` decide whether a planning node saturates before the
wireless channel."""
