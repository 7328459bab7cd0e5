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


@pytest.mark.parametrize(
    ("place", "said"),
    [
        ("sfglab.soc.rtl.synthesis", "make yosys"),
        ("sfglab.cli.mapping", r"pip install '.\[rtl\]' in a checkout"),
    ],
)
def test_verilog_without_its_tools_is_one_sentence_with_the_command(
    place, said, tmp_path, monkeypatch
):
    monkeypatch.setattr(f"{place}.find_spec", lambda _: None)
    with pytest.raises(SfglabError, match=said):
        call(FIGURE_8, "--verilog", str(tmp_path))


def test_the_paper_s_example_is_printed_with_its_mapping_and_its_edges():
    text = call(FIGURE_8)
    assert "\nnodes in software: 6, 8, 9\n" in text
    rows = re.findall(r"^(?:all )?topics in .*?(\d+) +(\d+) +(\d+)$", text, re.MULTILINE)
    assert rows == [("3", "7", "10"), ("2", "6", "8"), ("1", "2", "3")]
    assert "left: 9 -> E, A -> 8, C -> 6\n" in text
    times = re.search(r"^A +gateway +3 -> 1 +(\d+\.\d{3}) -> (\d+\.\d{3})$", text, re.MULTILINE)
    assert float(times[2]) < float(times[1])


@pytest.mark.parametrize(
    ("size", "rule", "said"),
    [
        ("size_bytes: 100", "paper", r"^A +gateway +3 -> 1 "),
        ("size_bytes: 100", "size", r"^A +software +3 -> 3 "),
        ("", "paper", r"^A +gateway +3 -> 1 +unknown -> unknown$"),
        ("", "size", r"topics\.A\.size_bytes: nothing is given"),
    ],
)
def test_small_messages_get_no_gateway_by_size_and_unknown_ones_no_time(size, rule, said, tmp_path):
    graph = tmp_path / "sized.yaml"
    graph.write_text(Path(FIGURE_8).read_text().replace("size_bytes: 1000000", size))
    try:
        text = call(str(graph), "--gateway-rule", rule)
    except SfglabError as error:
        text = str(error)
    assert re.search(said, text, re.MULTILINE)


def test_nodes_are_placed_within_the_areas_that_are_given(tmp_path):
    out = tmp_path / "placed.yaml"
    text = call(DRIVING, "--optimise-placement", "--lut", "40000", "--output", str(out))
    assert "no mapping takes less" in text
    assert 0 < int(re.search(r"area: (\d+) of 40000 LUT", text)[1]) <= 40000
    placed = load_graph(out).hardware_nodes
    assert 0 < len(placed) < len(load_graph(DRIVING).hardware_nodes)
    assert "camera" not in placed


def test_what_is_written_is_mapped_the_same_way_again_and_for_reconros_in_its_words(tmp_path):
    out, build_cfg = tmp_path / "mapped.yaml", tmp_path / "build.cfg"
    first = call(FIGURE_8, "--output", str(out))
    assert load_graph(out).mapped_to(TopicMapping.GATEWAY) == ("A", "C", "E")
    assert f"{call(str(out))}{out}\n" == first
    call(DRIVING, "--build-cfg", str(build_cfg))
    text = build_cfg.read_text()
    assert text.count("[ReconosThread@") == 6
    assert '[ROSGateway@gateway_A]\nSlot = Gateways(0)\nHWTopic = "A"\nSWTopic = "/A"' in text


@pytest.mark.parametrize(("suffix", "begin"), [("png", b"\x89PNG\r"), ("svg", b"<?xml")])
def test_a_graph_without_topics_is_mapped_too_and_drawn_as_the_file_s_name_asks(
    suffix, begin, tmp_path
):
    graph, picture = tmp_path / "lone.yaml", tmp_path / f"lone.{suffix}"
    graph.write_text("nodes: {a: {}}\n")
    assert "left: none" in call(str(graph), "--figure", str(picture))
    assert picture.read_bytes().startswith(begin)
