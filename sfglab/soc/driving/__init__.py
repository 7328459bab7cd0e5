"""The driving application of paper C, section 6, Fig. 9: a car in a simulated town, closed loop.

The world: `town`, `scene` (images of the camera) and `car` (motion, geometry of the camera). The nodes:
`nodes` (compensation, Gaussian blur, lane planner, polyfit, detection of red and of green light, lane
control) and `odometry`. `loop` connects both and drives laps, which `judge` assesses. `chain` computes
the transfer times of the node chain on a system-on-chip.
"""

from sfglab.soc.driving.car import Camera
from sfglab.soc.driving.chain import CHAIN, SHARED_TOPIC, Chain
from sfglab.soc.driving.judge import Judge, Verdict
from sfglab.soc.driving.loop import Frame, Lap, Moment, Stack, run_lap
from sfglab.soc.driving.scene import Scene
from sfglab.soc.driving.town import Town, make_town

__all__ = [
    "CHAIN",
    "SHARED_TOPIC",
    "Camera",
    "Chain",
    "Frame",
    "Judge",
    "Lap",
    "Moment",
    "Scene",
    "Stack",
    "Town",
    "Verdict",
    "make_town",
    "run_lap",
]
