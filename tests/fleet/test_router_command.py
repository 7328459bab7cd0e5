"""`sfglab router`: what it says of itself, and how it refuses."""

import re

import pytest
from typer.testing import CliRunner

from sfglab.cli import app, main


def call(*arguments: str):
    return CliRunner().invoke(app, ["router", *arguments])


def test_its_help_names_every_option_and_an_example():
    done = call("--help")
    text = re.sub(r"\x1b\[[0-9;]*m", "", done.output)
    assert done.exit_code == 0
    for option in ("domain", "interface", "global-domain", "global-interface", "agent", "prefix-frames"):
        assert f"--{option}" in text
    assert "sfglab router --domain 7" in text


@pytest.mark.parametrize(
    "arguments", [(), ("--domain", "seven"), ("--domain", "233"), ("--domain", "7", "--nowhere")]
)
def test_arguments_that_are_none_of_its_own_are_a_usage_error(arguments):
    done = call(*arguments)
    assert done.exit_code == 2
    assert "Usage" in done.output


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--domain", "0"), "domain on both sides: given 0, allowed: two"),
        (("--domain", "7", "--agent", "no name"), "no name"),
        (("--fleet", "data/fleets/lab.yaml", "--agent", "pi9"), "given 'pi9', allowed: go2, pi1"),
        (("--fleet", "nowhere.yaml"), "nowhere.yaml"),
        (("--domain", "101", "--agent", "go2", "--interface", "nowhere0"), "no network interface 'nowhere0'"),
    ],
)
def test_a_wrong_value_is_one_sentence(arguments, said, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["sfglab", "router", *arguments])
    with pytest.raises(SystemExit) as end:
        main()
    captured = capsys.readouterr()
    assert end.value.code == 1
    assert captured.err.startswith("sfglab: ")
    assert said in captured.err
    assert captured.err.count("\n") == 1
