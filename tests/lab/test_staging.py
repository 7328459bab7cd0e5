"""What an experiment starts is ended in the reverse order, also when starting fails halfway."""

from __future__ import annotations

import asyncio

import pytest

from sfglab.lab.staging import Staged


class Two(Staged):
    """Starts two things, or one and then fails."""

    def __init__(self, *, fails: bool) -> None:
        super().__init__()
        self.ended: list[str] = []
        self._fails = fails

    async def _start(self) -> None:
        self._stack.callback(self.ended.append, "first")
        await asyncio.sleep(0)
        if self._fails:
            raise OSError("no second one")
        self._stack.callback(self.ended.append, "second")


async def entered(two: Two) -> list[str]:
    async with two as same:
        assert same is two
        return list(two.ended)


def test_what_was_started_last_is_ended_first():
    two = Two(fails=False)
    assert asyncio.run(entered(two)) == []
    assert two.ended == ["second", "first"]


def test_what_was_started_before_a_failure_is_ended():
    two = Two(fails=True)
    with pytest.raises(OSError, match="no second one"):
        asyncio.run(entered(two))
    assert two.ended == ["first"]
