"""The seven methods that paper B compares, and the options of its Table 2. Pure."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Method:
    """One way to move the robots' data (paper B, sections 2.2 to 2.4)."""

    name: str  #: As in Fig. 10, 11 and 16.
    optimised: bool = False  #: OPT: the rate, and with the depth ``opt`` the depth too, come from Eq. 6.
    local_cache: bool = False  #: LC: a value that repeats is held back in the robot.
    cache_control: bool = False  #: CC: a value that repeats is discarded in the station before planning.


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

RATES_HZ = (100, 200, 500, 1000)
"""Table 2, DEADLINE: the values of Rmax."""

DEPTHS = (1, 5, 10, 100, 1000, 5000)
"""Table 2, DEPTH, beside the optimum of Eq. 6."""

TAKE_S = 60e-6
"""Time that taking a message and comparing it costs a node of the station: assumed, the paper says nothing."""

PLAN_S = 60e-6
"""Time that planning costs for each value it gets: assumed alike. Both together are within what one callback of
a ROS 2 executor takes on such a computer; they decide when a planning node, not the air, is what saturates."""
