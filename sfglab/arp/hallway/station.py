"""The module `station` has three localisations, the leader's planning, and the release of a move (Fig. 15).

Robot 1's planning decides a move from robot 1's localisation. The localisations of robots 2 and 3 release the move to
all robots if neither localisation sees an obstacle. All robots make the same move at the same time ("robot1 moves as a
leader", section 3.2), and each robot keeps to the middle of its own corridor. The module works without I/O: views are
inputs, manoeuvres and commands are outputs.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum

from sfglab.arp.hallway.course import HALF_WIDTH_M, ROBOTS
from sfglab.arp.hallway.nodes import SPEED_M_S, STOP, Command, LocalisationNode, View

TURN_MRAD_S = round(1000 * SPEED_M_S / HALF_WIDTH_M)
"""Speed of a turn in a corner: an arc from the middle of one corridor to the middle of the next corridor."""


class Manoeuvre(Enum):
    """A `Manoeuvre` is a move of all robots, which the station releases."""

    FORWARD = "forward"
    TURN_LEFT = "turn left"
    TURN_RIGHT = "turn right"
    STOP = "stop"


# An arc begins half a corridor before the corner's middle, and the wall is half a corridor behind the middle.
_CORNER_M = 2 * HALF_WIDTH_M
# The range of the open side exceeds the range of the closed side at least by this length; where the arc
# begins, the excess is 0.7 m.
_SIDE_MORE_M = 0.1
# A corridor with this range ahead is open; the shortest corridor has 2 m after its corner.
_OPEN_M = 1.8
# With this range ahead a robot has passed a corner; before two thirds of the arc the range is smaller.
_PAST_M = 1.2
# An arc ends at this remaining heading; the correction along the wall turns the robot by the remaining heading.
_ALONG_RAD = 0.15
_STRAIGHT_RAD = 0.05
_ROUND = 4  # A lap has this many more right turns than left turns.

# The correction is critically damped with a time constant of about two seconds, and tolerates a delay of half a
# second: the heading error vanishes within a metre of way.
_PER_RAD, _PER_M = 1.0, 1.0
_NARROW_M = 0.3
_EVADE_RAD_S = 0.2


@dataclass
class PlanningNode:
    """A `PlanningNode` is the planning of robot 1."""

    manoeuvre: Manoeuvre = Manoeuvre.FORWARD  #: Manoeuvre that the node decided last.
    _turns: int = field(default=0, repr=False)
    _home_m: float | None = field(default=None, repr=False)

    def decide(self, view: View) -> Manoeuvre:
        """Return the manoeuvre that the leader's view requires; after a stop at home no manoeuvre follows."""
        if self._home_m is None:
            self._home_m = view.ahead_m
        if self.manoeuvre is Manoeuvre.FORWARD:
            self.manoeuvre = self._at_corner_or_home(view)
        elif self.manoeuvre is not Manoeuvre.STOP and self._has_turned(view):
            self.manoeuvre = Manoeuvre.FORWARD
        return self.manoeuvre

    def _at_corner_or_home(self, view: View) -> Manoeuvre:
        if self._turns >= _ROUND and self._at_home(view):
            return Manoeuvre.STOP
        more_left = view.left_m - view.right_m
        if view.ahead_m > _CORNER_M or abs(more_left) < _SIDE_MORE_M:
            return Manoeuvre.FORWARD
        if more_left > 0:
            self._turns -= 1
            return Manoeuvre.TURN_LEFT
        self._turns += 1
        return Manoeuvre.TURN_RIGHT

    def _has_turned(self, view: View) -> bool:
        """Return whether a corridor is ahead, or the robot is parallel to the outer wall of the next corridor."""
        if view.ahead_m >= _OPEN_M:
            return True
        turns_right = self.manoeuvre is Manoeuvre.TURN_RIGHT
        heading = view.heading_left_rad if turns_right else view.heading_right_rad
        return heading is not None and abs(heading) <= _ALONG_RAD and view.ahead_m >= _PAST_M

    def _at_home(self, view: View) -> bool:
        # If the robot is not parallel to the walls, as after the last corner, the wall ahead seems nearer than it is.
        straight = view.heading_rad is not None and abs(view.heading_rad) <= _STRAIGHT_RAD
        return straight and self._home_m is not None and view.ahead_m <= self._home_m


def command_for(manoeuvre: Manoeuvre, view: View) -> Command:
    """Return the command of one robot: the common manoeuvre, and along a corridor the robot's own correction."""
    if manoeuvre is Manoeuvre.STOP:
        return Command(moving=False)
    if manoeuvre is Manoeuvre.FORWARD:
        return Command(moving=True, turn_mrad_s=_correction_mrad_s(view))
    return Command(
        moving=True, turn_mrad_s=TURN_MRAD_S if manoeuvre is Manoeuvre.TURN_LEFT else -TURN_MRAD_S
    )


def _correction_mrad_s(view: View) -> int:
    left, right = (min(view.left_m, view.beside_left_m), min(view.right_m, view.beside_right_m))
    turn = 0.0
    if min(left, right) < _NARROW_M:
        turn += _EVADE_RAD_S if right < left else -_EVADE_RAD_S
    if view.heading_rad is not None:
        turn -= _PER_RAD * view.heading_rad
    if view.offset_m is not None:
        turn -= _PER_M * view.offset_m
    most = TURN_MRAD_S
    return max(-most, min(most, round(1000 * turn)))


LEADER = 0  #: Index of the robot that plans for all robots.


class Station:
    """All nodes at the station: three localisations and the planning of the leading robot."""

    def __init__(self) -> None:
        self.localisations = [LocalisationNode() for _ in ROBOTS]  #: Localisation of each robot.
        self._planning = PlanningNode()
        self.commands = [STOP] * len(ROBOTS)  #: Present command of each robot.
        #: Index of the robot whose localisation last saw an obstacle and stopped all robots; None: none has.
        self.stopped_by: int | None = None
        self.manoeuvre = Manoeuvre.STOP  #: Manoeuvre that the station released last.

    def hear(self, robot: int, beam: int, step: int) -> bool:
        """Process the new range step of a robot's beam; return whether the command of any robot has changed.

        Args:
            robot: Index of the robot.
            beam: Index of the beam in `BEAMS_DEG`.
            step: Number of the range's step (`step_from_range`).
        """
        if not self.localisations[robot].hear(beam, step):
            return False
        views = [localisation.view for localisation in self.localisations]
        known = [view for view in views if view is not None]
        if len(known) < len(views):
            return False
        if robot == LEADER:
            self._planning.decide(known[LEADER])
        blocked = next((i for i, view in enumerate(known) if view.obstacle), None)
        self.stopped_by = self.stopped_by if blocked is None else blocked
        return self._release(
            self._planning.manoeuvre if blocked is None else Manoeuvre.STOP, known, robot
        )

    def _release(self, manoeuvre: Manoeuvre, views: list[View], robot: int) -> bool:
        """Set the commands that the views require; an unchanged manoeuvre changes only one robot's command."""
        before, self.commands = self.commands, self.commands.copy()
        for i in [robot] if manoeuvre is self.manoeuvre else range(len(views)):
            self.commands[i] = command_for(manoeuvre, views[i])
        self.manoeuvre = manoeuvre
        return self.commands != before
