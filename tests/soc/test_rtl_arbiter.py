"""The arbiter of the memory interface: the next waiting master is granted, one at a time, and none is passed twice."""

import pytest
from walked_core import simulate

rtl = pytest.importorskip("sfglab.soc.rtl", reason="needs the extra `rtl` (amaranth)")


def request(ctx, arbiter, waiting):
    """Let a set of masters wait, and return the masters that are granted."""
    for place, port in enumerate(arbiter.masters):
        ctx.set(port.request, place in waiting)
    return [place for place, port in enumerate(arbiter.masters) if ctx.get(port.grant)]


async def complete(ctx, arbiter, place):
    """Begin and end the granted request of a master; during it nothing is granted."""
    await ctx.tick()
    others = set(range(len(arbiter.masters))) - {place}
    assert request(ctx, arbiter, others) == []
    ctx.set(arbiter.masters[place].complete, 1)
    await ctx.tick()
    ctx.set(arbiter.masters[place].complete, 0)


@pytest.mark.parametrize("count", [1, 2, 5])
def test_in_every_state_the_next_waiting_master_behind_the_last_one_is_granted(count):
    arbiter = rtl.memory_port.Arbiter([rtl.memory_port.MemoryPort() for _ in range(count)])

    async def bench(ctx):
        assert request(ctx, arbiter, {0}) == [], "the memory is not free"
        ctx.set(arbiter.memory.grant, 1)
        for last in range(count):
            order = [(last + 1 + step) % count for step in range(count)]
            for mask in range(1 << count):
                assert request(ctx, arbiter, {last}) == [last]
                await complete(ctx, arbiter, last)
                waiting = [place for place in order if mask >> place & 1]
                assert request(ctx, arbiter, waiting) == waiting[:1]
                if waiting:
                    await complete(ctx, arbiter, waiting[0])

    simulate(arbiter, bench)
