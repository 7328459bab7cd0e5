"""`sfglab map`: what the command prints, draws and writes, and how it refuses."""

import re
from functools import partial
from pathlib import Path

import pytest
from commands import called
from graph_strategies import GRAPHS

from sfglab.errors import SfglabError
from sfglab.soc import TopicMapping, load_graph

FIGURE_8, DRIVING = str(GRAPHS / "figure_8.yaml"), str(GRAPHS / "driving.yaml")
call = partial(called, "map")


def test_verilog_without_its_tools_is_one_sentence_with_the_command(tmp_path, monkeypatch):
    monkeypatch.setattr("sfglab.soc.rtl.synthesis.find_spec", lambda _: None)
    with pytest.raises(SfglabError, match="make yosys"):
        call(FIGURE_8, "--verilog", str(tmp_path))
    monkeypatch.setattr("sfglab.cli.mapping.find_spec", lambda _: None)
    with pytest.raises(SfglabError, match=r"pip install '.\[rtl\]' in a checkout"):
        call(FIGURE_8, "--verilog", str(tmp_path))


def test_the_paper_s_example_is_printed_with_its_mapping_and_its_edges():
    text = call(FIGURE_8)
    mapped = dict(re.findall(r"^([A-E]) +(software|hardware|gateway) ", text, re.MULTILINE))
    assert mapped == {
        "A": "gateway",
        "B": "hardware",
        "C": "gateway",
        "D": "software",
        "E": "gateway",
    }
    assert re.search(r"^nodes in software: 6, 8, 9$", text, re.MULTILINE)
    rows = re.findall(r"^(?:all )?topics in .*?(\d+) +(\d+) +(\d+)$", text, re.MULTILINE)
    assert rows == [("3", "7", "10"), ("2", "6", "8"), ("1", "2", "3")]
    assert "left: 9 -> E, A -> 8, C -> 6\n" in text
    times = re.search(r"^A +gateway +3 -> 1 +(\d+\.\d{3}) -> (\d+\.\d{3})$", text, re.MULTILINE)
    assert float(times[2]) < float(times[1])


def test_small_messages_get_no_gateway_by_size_and_of_an_unknown_size_no_time_is_predicted(
    tmp_path,
):
    text = Path(FIGURE_8).read_text().replace("size_bytes: 1000000", "size_bytes: 100")
    (tmp_path / "small.yaml").write_text(text)
    assert "gateway " in call(str(tmp_path / "small.yaml"))
    assert not re.search(
        r"^\w +gateway ", call(str(tmp_path / "small.yaml"), "--gateway-rule", "size"), re.MULTILINE
    )
    text = Path(FIGURE_8).read_text().replace("    size_bytes: 1000000\n", "")
    (tmp_path / "unsized.yaml").write_text(text)
    said = call(str(tmp_path / "unsized.yaml"))
    assert re.search(r"^A +gateway +3 -> 1 +unknown -> unknown$", said, re.MULTILINE)
    with pytest.raises(SfglabError, match=r"unsized\.yaml|topics\.A\.size_bytes"):
        call(str(tmp_path / "unsized.yaml"), "--gateway-rule", "size")


def test_nodes_are_placed_within_the_areas_that_are_given(tmp_path):
    text = call(
        DRIVING, "--optimise-placement", "--lut", "40000", "--out", str(tmp_path / "placed.yaml")
    )
    assert "no mapping takes less" in text
    assert 0 < int(re.search(r"area: (\d+) of 40000 LUT", text)[1]) <= 40000
    placed = load_graph(tmp_path / "placed.yaml")
    assert 0 < len(placed.in_hardware) < len(load_graph(GRAPHS / "driving.yaml").in_hardware)
    assert placed.node("camera").in_hardware is False


def test_what_is_written_is_mapped_the_same_way_again_and_for_reconros_in_its_words(tmp_path):
    first = call(FIGURE_8, "--out", str(tmp_path / "mapped.yaml"))
    assert load_graph(tmp_path / "mapped.yaml").mapped_to(TopicMapping.GATEWAY) == ("A", "C", "E")
    assert f"{call(str(tmp_path / 'mapped.yaml'))}{tmp_path / 'mapped.yaml'}\n" == first
    call(DRIVING, "--build-cfg", str(tmp_path / "build.cfg"))
    text = (tmp_path / "build.cfg").read_text()
    assert text.count("[ReconosThread@") == 6
    assert '[ROSGateway@gateway_A]\nSlot = Gateways(0)\nHWTopic = "A"\nSWTopic = "/A"' in text


def test_a_graph_without_topics_is_mapped_too_and_drawn_as_the_file_s_name_asks(tmp_path):
    (tmp_path / "lone.yaml").write_text("nodes: {a: {}}\n")
    for name, begin in (("lone.png", b"\x89PNG\r"), ("lone.svg", b"<?xml")):
        assert "left: none" in call(str(tmp_path / "lone.yaml"), "--figure", str(tmp_path / name))
        assert (tmp_path / name).read_bytes().startswith(begin)
