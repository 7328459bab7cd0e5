"""The package `driving` has the driving application of paper C, section 6, Fig. 9: a car drives in a simulated town.

The modules `town`, `scene` and `car` simulate the town, the camera's images and the car's motion. The modules
`nodes` and `odometry` have the nodes of Fig. 9: compensation, Gaussian blur, lane planner, polyfit, detection of red
light, detection of green light, lane control and visual odometry. The module `loop` connects the nodes with the
simulation and drives laps. The module `judge` assesses a lap. The module `chain` computes the transfer times of the
node chain on a system-on-chip.
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
