"""The driving application of paper C, section 6, Fig. 9: a car in a simulated town, closed loop.

The world: `town`, `scene` (ground and camera's images), `car` (with its camera's optics). The nodes: `nodes`
(compensation, blur, lane planner, polyfit, light detection, lane control) and `odometry`. Over them `loop` with
the judge; beside them `chain`, the chain's transfers on a system-on-chip.
"""

from sfglab.soc.driving.car import Camera
from sfglab.soc.driving.chain import CHAIN, SHARED_TOPIC, Chain
from sfglab.soc.driving.loop import NODES, Frame, Judge, Lap, Rules, Stack, Stopwatch, run_lap
from sfglab.soc.driving.scene import Scene
from sfglab.soc.driving.town import Town, make_town

__all__ = [
    "CHAIN",
    "NODES",
    "SHARED_TOPIC",
    "Camera",
    "Chain",
    "Frame",
    "Judge",
    "Lap",
    "Rules",
    "Scene",
    "Stack",
    "Stopwatch",
    "Town",
    "make_town",
    "run_lap",
]
