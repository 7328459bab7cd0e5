"""What sensors say while objects move around them: values that stay for a random time. Pure, seeded.

The times between changes are exponential with Table 1's mean; what a value changes to is in the sensor's own
grain, as a DHT11 gives whole degrees.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from sfglab.arp.robots import Sensor


_STATES: dict[str, tuple[Any, Any]] = {
    "flame": (False, True),
    "pir": ("not detect", "detect"),
    "light": ("light", "dark"),
}
_GRAIN = {"lidar": 0.001, "dht11": 1.0, "imu": 1 / 16384, "ultrasonic": 0.003}
"""Smallest steps, in metres, degrees and g: data sheets of A2M8, DHT11, MPU-6050 (16384 a g) and HC-SR04."""


def readings(sensor: Sensor, *, rate_hz: float, duration_s: float, rng: np.random.Generator) -> list[Any]:
    """Return what reading a sensor at a rate gives, in order.

    Args:
        sensor: One of Table 1.
        rate_hz: How often it is read.
        duration_s: For how long, seconds.
        rng: Where chance comes from.
    """
    count = int(rate_hz * duration_s)
    changes = np.cumsum(rng.exponential(sensor.change_s, int(3 * duration_s / sensor.change_s) + 10))
    number = np.searchsorted(changes, np.arange(count) / rate_hz, side="right")
    if sensor.name in _STATES:
        return [_STATES[sensor.name][n % 2] for n in number]
    steps = np.cumsum(rng.integers(1, 4, len(changes) + 1) * rng.choice((-1, 1), len(changes) + 1))
    return [float(np.float32(sensor.example + steps[n] * _GRAIN[sensor.name])) for n in number]
