"""The gateway core's table as a program, against which the hardware is compared, and a simulation."""

from sfglab.soc.gateway import TABLE, Input, Register, Row, State, Transition


def mutated(state, given, target, table=TABLE):
    """The table in which an input in one state leads to another state."""
    row = table[state]
    changed = Transition(target, row.transitions[given].loads)
    return {**table, state: Row(row.action, {**row.transitions, given: changed})}


class Core:
    """A core, first at `START`; an input that its state does not wait for changes nothing."""

    def __init__(self):
        self.state = State.START
        self.output = self.held = 0

    def feed(self, given: Input, value=0):
        transition = TABLE[self.state].transitions.get(given)
        if transition is None:
            return
        self.state = transition.target
        if transition.loads is Register.OUTPUT:
            self.output = value
        if transition.loads is Register.HELD:
            self.held = value


def simulate(hardware, bench, background=()):
    """Run hardware with a clock until a coroutine function of the simulation's context ends."""
    from amaranth.sim import Simulator

    simulator = Simulator(hardware)
    simulator.add_clock(1e-8)
    for process in background:
        simulator.add_testbench(process, background=True)
    simulator.add_testbench(bench)
    simulator.run()
