"""Paper B's robots: the sensors of Table 1 with what they send, the seven methods, the options of Table 2.

Table 1 has the sizes of the values as Python objects, as `sys.getsizeof` returns them: 24 bytes for a float, 28
for a truth value, 49 and one per letter for a text. On the wire the same values travel as CDR, with header and
padding: a float as 8 bytes, a truth value as 8, and the two texts as 20 and 16. Both sizes are here. Pure.
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
    """One row of Table 1."""

    name: str  #: Name of the device in topics.
    type: str  #: ROS type of its messages.
    #: A value that it sends; of the paper's two texts, the one of Table 1's size.
    example: float | bool | str
    table_bytes: int  #: Size in Table 1.
    #: Mean time between changes of its value, seconds, while objects move around it.
    change_s: float


_FLOAT, _BOOL, _STRING = "std_msgs/msg/Float32", "std_msgs/msg/Bool", "std_msgs/msg/String"

_SENSORS = (
    # SLAMTEC A2M8: it turns 10 times per second (data sheet), so one direction has a new range as often.
    Sensor("lidar", _FLOAT, 1.25, 24, 0.1),
    # AYNEF flame sensor module, a threshold switch: a flame or a lamp now and then is assumed.
    Sensor("flame", _BOOL, False, 28, 30.0),
    # HiLetgo DHT11: one reading per second, whole degrees (data sheet); a new one every ten seconds is assumed.
    Sensor("dht11", _FLOAT, 22.0, 24, 10.0),
    # HiLetgo MPU-6050: 1000 readings per second (data sheet), and noise makes each of them differ.
    Sensor("imu", _FLOAT, 0.02, 24, 0.001),
    # ELEGOO HC-SR04: one measurement takes 60 ms (data sheet).
    Sensor("ultrasonic", _FLOAT, 0.73, 24, 0.06),
    # HiLetgo HC-SR501: it holds its output for 3 s at least (data sheet).
    Sensor("pir", _STRING, "not detect", 59, 3.0),
    # VKLSVAN photosensitive sensor module, a threshold switch: a person passing every ten seconds is assumed.
    Sensor("light", _STRING, "light", 54, 10.0),
)
SENSORS = {sensor.name: sensor for sensor in _SENSORS}
"""Paper B, Table 1, by name; makers and models as in section 3.1."""

ROBOTS = {
    "robot1": ("lidar", "light", "flame", "dht11", "imu", "pir"),
    "robot2": ("flame", "pir", "ultrasonic", "dht11", "light"),
    "robot3": ("flame", "pir", "ultrasonic", "dht11", "light"),
}
"""Sensors of each robot: paper B, section 3.1."""


def object_bytes(sensor: Sensor) -> int:
    """Return the size of a sensor's value as a Python object, which is what Table 1 gives."""
    return sys.getsizeof(sensor.example)


def cdr_bytes(sensor: Sensor) -> int:
    """Return the size of a sensor's message on the wire: CDR with its 4-byte header, padded to whole words."""
    return len(serialize(message_type(sensor.type)(data=sensor.example)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Method:
    """One way to move the robots' data (paper B, sections 2.2 to 2.4)."""

    name: str  #: As in Fig. 10, 11 and 16.
    #: OPT: the rate, and with the depth ``opt`` the depth too, come from Eq. 6.
    optimised: bool = False
    local_cache: bool = False  #: LC: a value that repeats is held back in the robot.
    #: CC: a value that repeats is discarded in the station before planning.
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
"""Paper B, section 3, by name."""

BEST = "OPT+LC"  #: Method with the lowest latency and loss by the paper, and with which the lap is completed.

MethodName = Literal["none", "OPT", "CC", "LC", "OPT+CC", "OPT+LC", "OPT+LC+CC"]
Rate = Annotated[int, Bounds(10, 1000, log=True)]  #: A value of Rmax.
Depth = Annotated[int, Bounds(1, 5000, log=True)]  #: A depth of a history.
RATES_HZ = (100, 200, 500, 1000)  #: Table 2, DEADLINE: the values of Rmax.

DEPTHS = (1, 5, 10, 100, 1000, 5000)  #: Table 2, DEPTH, beside the optimum of Eq. 6.


def topic_qos(rate_hz: float, depth: int) -> QoSProfile:
    """Return the QoS of Table 2: RELIABLE, KEEP_LAST with a depth, and the period of a rate, Hz, as DEADLINE."""
    return QoSProfile(depth=depth, deadline_ns=round(NS_PER_S / rate_hz))


TAKE_S = 60e-6
"""Time that taking a message and comparing it costs a node of the station: assumed, as the paper has no value."""

PLAN_S = 60e-6
"""Time that planning costs for each value it gets: assumed alike. Both together are within what one callback of
a ROS 2 executor takes on such a computer; they decide when a planning node, not the air, is what saturates."""
