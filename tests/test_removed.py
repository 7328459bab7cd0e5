"""Removed commands name their replacement; former names of options are accepted with a warning."""

from pathlib import Path

import pytest
from commands import called, commands

from sfglab.cli.removed import RENAMED, REPLACEMENTS

DATA = Path(__file__).parents[1] / "data"
QOS, GRAPH = DATA / "qos/paper_b.yaml", DATA / "graphs/driving.yaml"


@pytest.mark.parametrize("command", REPLACEMENTS)
@pytest.mark.parametrize("rest", ["", "list -t --domain 7", "--help", "/chatter --json x.mcap"])
def test_a_removed_command_is_one_sentence_and_status_2(command, rest):
    said = called(*command.split(), *rest.split(), status=2)
    assert said == f"sfglab {command}: was removed; {REPLACEMENTS[command]}\n"


def test_a_removed_place_to_view_is_one_sentence_and_status_2():
    said = called("view", "--domain", "7", "--to", "foxglove:8765", status=2)
    assert said.startswith("sfglab view --to foxglove: was removed; ")
    assert said.count("\n") == 1


def test_removed_commands_are_not_listed():
    there = {" ".join(words) for words, _ in commands()}
    assert there.isdisjoint(REPLACEMENTS)
    for command in REPLACEMENTS:
        *group, name = command.split()
        assert f"\n  {name} " not in called(*group, "--help")


@pytest.mark.parametrize(
    ("former", "todays", "warned"),
    [
        (f"qos {QOS} --method printed", f"qos {QOS} --method paper", "--method printed"),
        (f"qos {QOS} --method=printed", f"qos {QOS} --method paper", "--method printed"),
        (f"qos {QOS} --latency-price 5", f"qos {QOS} --latency-weight 5", "--latency-price"),
        (f"qos {QOS} --front", f"qos {QOS} --pareto", "--front"),
        (f"map {GRAPH} --rule=size", f"map {GRAPH} --gateway-rule size", "--rule"),
        (f"map {GRAPH} --place", f"map {GRAPH} --optimise-placement", "--place"),
    ],
)
def test_a_former_name_of_an_option_does_the_same_with_a_warning(former, todays, warned):
    new = RENAMED[former.partition(" ")[0]][warned]
    warning = f"warning: {warned} is now called {new}\n"
    assert called(*former.split()) == warning + called(*todays.split())
