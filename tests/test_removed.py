"""Removed commands name their replacement, whatever follows them."""

import pytest
from commands import called, commands

from sfglab.cli.removed import REPLACEMENTS


@pytest.mark.parametrize("command", REPLACEMENTS)
@pytest.mark.parametrize("rest", ["", "list -t --domain 7", "--help", "/chatter --json x.mcap"])
def test_a_removed_command_is_one_sentence_and_status_2(command, rest):
    said = called(*command.split(), *rest.split(), status=2)
    assert said == f"sfglab {command}: was removed; {REPLACEMENTS[command]}\n"


def test_removed_commands_are_not_listed():
    there = {" ".join(words) for words, _ in commands()}
    assert there.isdisjoint(REPLACEMENTS)
    for command in REPLACEMENTS:
        *group, name = command.split()
        assert f"\n  {name} " not in called(*group, "--help")
