"""The arbiter of the memory interface: the next in turn, one at a time, nobody waits longer than all others."""

import random

import pytest
from walked_core import simulate

rtl = pytest.importorskip("sfglab.soc.rtl", reason="needs the extra `rtl` (amaranth)")


def clocked(masters, run):
    """Run a coroutine of (context, arbiter) beside an arbiter of so many masters."""
    arbiter = rtl.readers.Arbiter([rtl.data_path.MemoryPort() for _ in range(masters)])

    async def bench(ctx):
        ctx.set(arbiter.memory.grant, 1)
        await run(ctx, arbiter)

    simulate(arbiter, bench)


async def serve(ctx, arbiter, waiting):
    """Let a set of masters wait, complete the request that is granted, and return whose it was."""
    for place, port in enumerate(arbiter.masters):
        ctx.set(port.request, place in waiting)
    granted = [place for place, port in enumerate(arbiter.masters) if ctx.get(port.grant)]
    await ctx.tick()
    for place, port in enumerate(arbiter.masters):
        ctx.set(port.complete, place in granted)
    await ctx.tick()
    return granted


def test_of_every_set_that_waits_the_next_behind_the_last_turn_is_granted():
    count, wrong = 5, []

    async def run(ctx, arbiter):
        for turn in range(count):
            for mask in range(1 << count):
                waiting = {place for place in range(count) if mask >> place & 1}
                await serve(ctx, arbiter, {turn})
                order = [(turn + 1 + step) % count for step in range(count)]
                wanted = [place for place in order if place in waiting][:1]
                if (found := await serve(ctx, arbiter, waiting)) != wanted:
                    wrong.append((turn, waiting, found))

    clocked(count, run)
    assert not wrong


@pytest.mark.parametrize("masters", [1, 3, 8])
def test_among_random_requests_no_free_cycle_is_lost_and_nobody_is_passed_twice(masters):
    dice, served, holder = random.Random(masters), [], None
    waiting, passed = set(), {place: [] for place in range(masters)}

    async def run(ctx, arbiter):
        nonlocal holder
        for _ in range(800):
            waiting.update(i for i in range(masters) if i != holder and dice.random() < 0.2)
            ends = holder is not None and dice.random() < 0.3
            free = dice.random() < 0.9
            ctx.set(arbiter.memory.grant, free)
            for place, port in enumerate(arbiter.masters):
                ctx.set(port.request, place in waiting)
                ctx.set(port.complete, ends and place == holder)
            granted = [i for i, port in enumerate(arbiter.masters) if ctx.get(port.grant)]
            assert len(granted) == (holder is None and free and bool(waiting))
            assert waiting.issuperset(granted)
            waiting.difference_update(granted)
            for place in waiting:
                passed[place] += granted
                assert len(set(passed[place])) == len(passed[place])
            for place in granted:
                served.append(place)
                passed[place].clear()
            holder = granted[0] if granted else None if ends else holder
            await ctx.tick()

    clocked(masters, run)
    assert set(served) == set(range(masters))


def test_the_memory_sees_the_wires_of_the_one_whose_turn_it_is_and_only_that_one_is_answered():
    seen = []

    async def run(ctx, arbiter):
        for place, port in enumerate(arbiter.masters):
            ctx.set(port.address, 0x100 * place)
            ctx.set(port.address_valid, 1)
            ctx.set(port.request, place == 2)
        seen.append(ctx.get(arbiter.memory.address_valid))
        await ctx.tick()
        ctx.set(arbiter.memory.read_valid, 1)
        seen.extend([ctx.get(arbiter.memory.address_valid), ctx.get(arbiter.memory.address)])
        seen.append([ctx.get(port.read_valid) for port in arbiter.masters])

    clocked(4, run)
    assert seen == [0, 1, 0x200, [0, 0, 1, 0]]
