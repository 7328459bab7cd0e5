"""A third backend: endpoints of the simulated world in real time, so that nodes of DDS run beside them."""

import asyncio
import heapq
import time
from functools import partial
from itertools import count
from random import Random

from sfglab import bus
from sfglab.bus.sim.backend import SimBackend
from sfglab.bus.sim.domain import Domain, Host, Participant, Process
from sfglab.bus.sim.loop import START_NS
from sfglab.bus.sim.settings import Costs


class RealTime:
    """Time and events as a `VirtualLoop` has them, on the running loop."""

    def __init__(self):
        self._events, self._numbers = [], count()

    @property
    def now_ns(self):
        return time.time_ns() - START_NS

    def at(self, time_ns, function, *arguments):
        heapq.heappush(self._events, (time_ns, next(self._numbers), function, arguments))
        wait_s = max(0, time_ns - self.now_ns) / 1e9
        asyncio.get_running_loop().call_later(wait_s, self._run, time_ns)

    def _run(self, until_ns):
        while self._events and self._events[0][0] <= until_ns:
            _, _, function, arguments = heapq.heappop(self._events)
            function(*arguments)


class ToyBackend(SimBackend):
    kind = "toy"


class OtherToyBackend(SimBackend):
    """A backend of another kind, so that forwarding between the two is between backends."""

    kind = "other toy"


class ToyDomain:
    """A domain on one host."""

    def __init__(self):
        self._domain, self._numbers = Domain(RealTime(), Costs()), count()
        self._host = Host("here", 0)

    def node(self, name, *, kind=ToyBackend, **options):
        return bus.Node(name, join=partial(self._join, kind), **options)

    def _join(self, kind, name):
        graph = bus.Graph(asyncio.get_running_loop())
        options = {"name": name, "number": next(self._numbers), "lease_ns": 10**10}
        participant = Participant(self._domain, self._host, Process(), graph, **options)
        self._domain.join(participant)
        return kind(participant, Random())
