"""The chain across processes: every node of Fig. 9 is one, scheduled by Linux, on the bus of this host.

What this is not: the board. A gateway's saved crossings are there, as one copy in shared memory in place of one
for each reader by DDS; that it takes the chain out of the scheduler's hands is not, for nodes that are hardware
in the paper are processes here, on the same cores as everything else.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sfglab.bus.address import BusAddress
from sfglab.lab.experiment import SkippedPartError
from sfglab.lab.experiments.driving.experiment import Config, exp
from sfglab.lab.testbed import held_domains
from sfglab.lab.workers.driving import NAMES, DrivingNodeConfig
from sfglab.processes import Member, ProcessGroup
from sfglab.soc.driving import CHAIN

if TYPE_CHECKING:
    from sfglab.lab.bench import Bench

_MODULE = "sfglab.lab.workers.driving"
_SLACK_S = 60.0


@exp.table("live")
class DrivingLiveRow:
    """A picture's way along the chain across processes."""

    mapping: str  #: What topic A was mapped to.
    started_s: float  #: When the compensation had it, from the first one's.
    chain_s: float  #: From there to the command; NaN: it was lost.


@exp.part("live", timed=False)
async def drive_live(bench: Bench[Config]) -> None:
    """Run the chain's nodes as processes."""
    config = bench.config
    if not config.live_s:
        raise SkippedPartError("live: no time was asked for (live_s)")
    with held_domains() as (domain,):
        told: dict[str, Any] = {
            "address": BusAddress(domain_id=domain, interface="lo"),
            "width": config.chain.width,
            "height": config.chain.height,
            "rate_hz": config.live_hz,
            "live_s": config.live_s,
            "seed": config.seed,
        }
        members = [
            Member(name=name, module=_MODULE, config=DrivingNodeConfig(node=name, **told)) for name in NAMES
        ]
        async with ProcessGroup(lambda _host, command: command, members) as nodes:
            await nodes.ask("over", NAMES[:1], timeout_s=config.live_s + _SLACK_S, do="go")
            ends = await nodes.ask("stopped", [CHAIN[0], CHAIN[-1]], timeout_s=_SLACK_S, do="stop")
    done_ns = dict(ends[CHAIN[-1]]["frames"])
    began = ends[CHAIN[0]]["frames"]
    for at_ns, mapping in began:
        chain_s = (done_ns[at_ns] - at_ns) / 1e9 if at_ns in done_ns else float("nan")
        bench.write("live", {"mapping": mapping, "started_s": (at_ns - began[0][0]) / 1e9, "chain_s": chain_s})
