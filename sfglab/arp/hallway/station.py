"""The station: three localisations and the leader's planning, and how a move is released (Fig. 15).

Robot 1's planning decides from its localisation; the decision goes on to the localisations of robots 2 and 3,
inside the station; robot 3's releases it to all robots if neither sees an obstacle in its area.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from sfglab.arp.hallway.nodes import STOP, LocalisationNode
from sfglab.arp.hallway.planning import Manoeuvre, PlanningNode, command_for

if TYPE_CHECKING:
    from sfglab.arp.hallway.nodes import View


LEADER = 0
"""Whose planning moves all."""


class Station:
    """The nodes at the station.

    Args:
        robots: How many; the first one leads.

    Attributes:
        commands: What each robot is told at present.
        stopped_by: Robot whose localisation was the last to see an obstacle and stop all; None: none has.
        manoeuvre: What was released last.
    """

    def __init__(self, robots: int = 3) -> None:
        self._localisations = [LocalisationNode() for _ in range(robots)]
        self._planning = PlanningNode()
        self.commands = [STOP] * robots
        self.stopped_by: int | None = None
        self.manoeuvre = Manoeuvre.STOP

    def hear(self, robot: int, beam: int, step: int) -> bool:
        """Take a beam's value, and return whether anybody's command is another one now.

        Args:
            robot: Whose beam.
            beam: Index in `BEAMS_DEG`.
            step: Its value.
        """
        if not self._localisations[robot].hear(beam, step):
            return False
        views = [localisation.view for localisation in self._localisations]
        known = [view for view in views if view is not None]
        if len(known) < len(views):
            return False
        if robot == LEADER:
            self._planning.decide(known[LEADER])
        blocked = next((i for i, view in enumerate(known) if view.obstacle), None)
        self.stopped_by = self.stopped_by if blocked is None else blocked
        return self._release(self._planning.manoeuvre if blocked is None else Manoeuvre.STOP, known, robot)

    def _release(self, manoeuvre: Manoeuvre, views: list[View], robot: int) -> bool:
        """Command what the views ask for; without a new manoeuvre it is another command for one robot only."""
        before, self.commands = self.commands, self.commands.copy()
        for i in [robot] if manoeuvre is self.manoeuvre else range(len(views)):
            self.commands[i] = command_for(manoeuvre, views[i])
        self.manoeuvre = manoeuvre
        return self.commands != before
