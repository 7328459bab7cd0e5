"""The arbiter of the memory interface: the next waiting master is granted, one at a time, and none is passed twice."""

import pytest
from walked_core import simulate

rtl = pytest.importorskip("sfglab.soc.rtl", reason="needs the extra `rtl` (amaranth)")


def run_arbiter(masters, bench):
    """Run a coroutine function of (context, arbiter) beside an arbiter of so many masters."""
    arbiter = rtl.memory_port.Arbiter([rtl.memory_port.MemoryPort() for _ in range(masters)])

    async def with_free_memory(ctx):
        ctx.set(arbiter.memory.grant, 1)
        await bench(ctx, arbiter)

    simulate(arbiter, with_free_memory)


def request(ctx, arbiter, waiting):
    """Let a set of masters wait, and return the masters that are granted."""
    for place, port in enumerate(arbiter.masters):
        ctx.set(port.request, place in waiting)
    return [place for place, port in enumerate(arbiter.masters) if ctx.get(port.grant)]


async def complete(ctx, arbiter, place):
    """Begin and end the granted request of a master."""
    await ctx.tick()
    ctx.set(arbiter.masters[place].complete, 1)
    await ctx.tick()
    ctx.set(arbiter.masters[place].complete, 0)


@pytest.mark.parametrize("count", [1, 2, 5])
def test_in_every_state_the_next_waiting_master_behind_the_last_one_is_granted(count):
    wrong = []

    async def bench(ctx, arbiter):
        for last in range(count):
            order = [(last + 1 + step) % count for step in range(count)]
            for mask in range(1 << count):
                assert request(ctx, arbiter, {last}) == [last]
                await complete(ctx, arbiter, last)
                waiting = {place for place in range(count) if mask >> place & 1}
                granted = request(ctx, arbiter, waiting)
                if granted != [place for place in order if place in waiting][:1]:
                    wrong.append((last, waiting, granted))
                if granted:
                    await complete(ctx, arbiter, granted[0])

    run_arbiter(count, bench)
    assert not wrong


def test_nothing_is_granted_during_a_request_or_while_the_memory_is_not_free():
    async def bench(ctx, arbiter):
        ctx.set(arbiter.memory.grant, 0)
        assert request(ctx, arbiter, {0, 1}) == []
        ctx.set(arbiter.memory.grant, 1)
        assert request(ctx, arbiter, {0, 1}) == [0]
        await ctx.tick()
        assert request(ctx, arbiter, {1}) == []

    run_arbiter(2, bench)
