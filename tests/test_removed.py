"""Removed commands name their replacement; former names of options are accepted with a warning."""

from pathlib import Path

import pytest
from commands import called, commands

from sfglab.cli.removed import RENAMED, REPLACEMENTS

DATA = Path(__file__).parents[1] / "data"
QOS = DATA / "qos/paper_b.yaml"
GRAPH = DATA / "graphs/driving.yaml"


@pytest.mark.parametrize("command", REPLACEMENTS)
@pytest.mark.parametrize("rest", ["", "--help", "/chatter --json x.mcap"])
def test_a_removed_command_is_one_sentence_and_status_2_and_is_not_listed(command, rest):
    said = called(*command.split(), *rest.split(), status=2)
    assert said == f"sfglab {command} was removed: {REPLACEMENTS[command]}\n"
    *group, name = command.split()
    assert f"\n  {name} " not in called(*group, "--help")


@pytest.mark.parametrize(
    ("command", "removed"),
    [
        ("view --domain 7 --to foxglove:8765", "view --to foxglove"),
        ("view --domain 7 --to rerun+http://host:9876/proxy", "view --to rerun+http"),
        ("view --domain 7 --to serve:9876", "view --to serve"),
        (f"qos {QOS} --vendor=cyclone_dds --rmw cyclone", "qos --vendor"),
    ],
)
def test_a_removed_option_or_value_is_one_sentence_and_status_2(command, removed):
    said = called(*command.split(), status=2)
    assert said.startswith(f"sfglab {removed} was removed: ")
    assert said.count("\n") == 1


def test_a_former_name_has_no_other_use():
    parameters = [parameter for _, command in commands() for parameter in command.params]
    names = {name for parameter in parameters for name in parameter.opts}
    assert names.isdisjoint(RENAMED)


@pytest.mark.parametrize(
    ("former", "todays", "warned"),
    [
        (f"qos {QOS} --method=printed", f"qos {QOS} --method paper", "printed"),
        (f"qos {QOS} --front", f"qos {QOS} --pareto", "--front"),
        (f"qos {QOS} --latency-price 5", f"qos {QOS} --latency-weight 5", "--latency-price"),
        (f"map {GRAPH} --rule=size", f"map {GRAPH} --gateway-rule size", "--rule"),
        ("mocap run x --trees --help", "mocap run x --publish-tf --help", "--trees"),
        (f"map {GRAPH} --place", f"map {GRAPH} --optimise-placement", "--place"),
        ("frames lint --listen 9 --help", "frames lint --duration 9 --help", "--listen"),
        ("map --seconds 9 --help", "map --duration 9 --help", "--seconds"),
        ("schema fleet --out x --help", "schema fleet --output x --help", "--out"),
        ("view --frame map --help", "view --root-frame map --help", "--frame"),
    ],
)
def test_a_former_name_of_an_option_does_the_same_with_a_warning(former, todays, warned):
    warning = f"warning: {warned} is now called {RENAMED[warned]}\n"
    assert called(*former.split()) == warning + called(*todays.split())
