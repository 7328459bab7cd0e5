"""The driving application of paper C, section 6, Fig. 9: a car in a simulated town, closed loop.

What the nodes live in: `town`, `ground`, `scene` (the camera's images), `optics`, `car`. The nodes:
`compensation`, `blur`, `lanes`, `polyfit`, `lights`, `odometry`, `control`; each has its `Ports`. Over them
`judge` and `loop`; beside them `chain`, the chain's transfers on a system-on-chip.
"""

from __future__ import annotations

from sfglab.soc.driving import blur as _blur
from sfglab.soc.driving import car as _car
from sfglab.soc.driving import compensation as _compensation
from sfglab.soc.driving import control as _control
from sfglab.soc.driving import lanes as _lanes
from sfglab.soc.driving import lights as _lights
from sfglab.soc.driving import odometry as _odometry
from sfglab.soc.driving import polyfit as _polyfit
from sfglab.soc.driving import scene as _scene
from sfglab.soc.driving.chain import CHAIN, SHARED_TOPIC, Chain, ChainError, Order
from sfglab.soc.driving.judge import Judge, Rules, Verdict
from sfglab.soc.driving.loop import Frame, Lap, Stack, Stopwatch, run_lap
from sfglab.soc.driving.optics import Camera, CameraError
from sfglab.soc.driving.ports import Ports
from sfglab.soc.driving.scene import Scene
from sfglab.soc.driving.town import Town, make_town

__all__ = [
    "CHAIN",
    "NODES",
    "SHARED_TOPIC",
    "Camera",
    "CameraError",
    "Chain",
    "ChainError",
    "Frame",
    "Judge",
    "Lap",
    "Order",
    "Ports",
    "Rules",
    "Scene",
    "Stack",
    "Stopwatch",
    "Town",
    "Verdict",
    "make_town",
    "run_lap",
]

NODES: tuple[Ports, ...] = (
    _scene.PORTS,
    _compensation.PORTS,
    _blur.PORTS,
    _lanes.PORTS,
    _polyfit.PORTS,
    _lights.RED_PORTS,
    _lights.GREEN_PORTS,
    _odometry.PORTS,
    _control.PORTS,
    _car.PORTS,
)
"""Every node's topics, in the order of the chain; a test compares them with the graph's file."""
