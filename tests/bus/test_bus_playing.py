"""A log is played to readers that are slower than the log, and past a stalled reader."""

import asyncio

import pytest
from bus_messages import text

from sfglab.bus import recording
from sfglab.messages import serialize
from sfglab.qos import QoSProfile, Reliability
from sfglab.record import LogWriter

pytestmark = pytest.mark.live

COUNT, RATE_HZ, STOPPED_S = 3000, 1200, 2.0
LISTENER = f"""
numbers = []
def hears(message):
    numbers.append(int(message.data))
    if len(numbers) == 100:
        say(begun=True)
node.create_subscription(String, "/counted", hears, QoSProfile(depth={COUNT}), transport="dds")
say(ready=True)
await hear()
say(numbers=numbers)
"""


@pytest.fixture(name="play")
def _play(live, tmp_path):
    """A function that plays numbers of 1500 digits, and returns how many, and what the user is told."""

    async def play(reliability=Reliability.RELIABLE):
        qos, told = QoSProfile(reliability=reliability), []
        with LogWriter(tmp_path / "counted.mcap") as log:
            for number in range(COUNT):
                cdr, at_ns = serialize(text(f"{number:01500d}")), round(1e9 * number / RATE_HZ)
                log.write_raw("/counted", "std_msgs/msg/String", cdr, log_time_ns=at_ns, qos=qos)
        async with live.node("player") as node:
            how = recording.Playing()
            player = recording.Player(
                node, log.path, how, wanted=lambda _: True, on_log=told.append
            )
            await player.run()
        return player.counts["/counted"], told

    return play


async def test_who_was_stopped_for_longer_than_is_kept_has_all(play, child):
    async with child(LISTENER, "listener") as listener:
        await listener.hear()
        playing = asyncio.ensure_future(play())
        await listener.hear()
        await listener.stop()
        await asyncio.sleep(STOPPED_S)
        listener.go_on()
        assert await playing == (COUNT, [])
        await listener.tell()
        assert (await listener.hear())["numbers"] == [*range(COUNT)]


async def test_who_stands_still_is_told_and_waited_for_once(play, child, monkeypatch):
    monkeypatch.setattr(recording, "_STANDS_STILL_S", 0.3)
    async with child(LISTENER, "listener", lease_s=1000.0) as listener:
        await listener.hear()
        playing = asyncio.ensure_future(play())
        await listener.hear()
        await listener.stop()
        count, [said] = await playing
        assert count == COUNT
        assert (
            said == "Topic '/counted': a subscription stands still, and is not waited for any more"
        )


async def test_for_who_asked_for_no_acknowledgement_nobody_waits(play, monkeypatch):
    monkeypatch.setattr(recording, "_STANDS_STILL_S", 0.0)
    assert await play(Reliability.BEST_EFFORT) == (COUNT, [])
