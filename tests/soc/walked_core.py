"""The gateway core's table, walked: the oracle of the hardware; and hardware run beside a bench."""

from sfglab.soc.gateway import TABLE, Drive, Input, Latch, State


class Core:
    """A core at `START`; an input that its state does not wait for changes nothing."""

    def __init__(self) -> None:
        self.state = State.START
        self.output = self.held = 0

    @property
    def drive(self) -> Drive:
        return TABLE[self.state].drive

    @property
    def waits_for(self) -> frozenset[Input]:
        return frozenset(TABLE[self.state].moves)

    def feed(self, given: Input, value: int = 0) -> Drive:
        move = TABLE[self.state].moves.get(given)
        if move is not None:
            self.output = value if move.latch is Latch.OUTPUT else self.output
            self.held = value if move.latch is Latch.HELD else self.held
            self.state = move.to
        return self.drive


def simulate(hardware, bench):
    """Run hardware with a clock beside a coroutine function of the simulation's context, until that ends."""
    from amaranth.sim import Simulator

    simulator = Simulator(hardware)
    simulator.add_clock(1e-8)
    simulator.add_testbench(bench)
    simulator.run()
