"""The core's control in hardware: in every cycle the state, the registers and the drive of the table."""

from __future__ import annotations

import pytest
from walked_core import Core

from sfglab.soc.gateway import TABLE, Input, State

rtl = pytest.importorskip("sfglab.soc.rtl", reason="needs the extra `rtl` (amaranth)")


def clocked(steps):
    """Give the control (input, value) cycle by cycle and return what it shows after each, beside the core."""
    from amaranth.sim import Simulator

    control, core, seen = rtl.core.Control(), Core(), []
    simulator = Simulator(control)
    simulator.add_clock(1e-8)

    async def feed(ctx):
        for given, value in steps(core):
            ctx.set(control.given, 0 if given is None else 1 << rtl.core.code(given))
            ctx.set(control.value, value)
            await ctx.tick()
            if given is not None:
                core.feed(given, value)
            shown = [ctx.get(wire) for wire in (control.state, control.drive, control.output, control.held)]
            wanted = [rtl.core.code(core.state), 1 << rtl.core.code(core.drive), core.output, core.held]
            seen.append((shown, wanted))

    simulator.add_testbench(feed)
    simulator.run()
    return seen


def way(start, goal):
    """A shortest sequence of inputs from one state to another."""
    found, front = {start: []}, [start]
    while goal not in found:
        state = front.pop(0)
        for given, move in TABLE[state].moves.items():
            if move.to not in found:
                found[move.to] = [*found[state], given]
                front.append(move.to)
    return found[goal]


def test_control_and_table_agree_on_every_input_in_every_state():
    reached = set()

    def steps(core):
        # START is left for good by its one input, so that input comes last there.
        for given in [*(item for item in Input if item is not Input.LOCATED), Input.LOCATED]:
            reached.add((core.state, given))
            yield given, 5
        for state in set(State) - {State.START}:
            for given in Input:
                for item in way(core.state, state):
                    yield item, 7
                reached.add((core.state, given))
                yield None, 8
                yield given, 2**64 - 9

    seen = clocked(steps)
    assert [shown for shown, _ in seen] == [wanted for _, wanted in seen]
    assert len(reached) == len(State) * len(Input)
