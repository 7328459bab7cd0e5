"""What strangers say of themselves, and candidates that come late: one test for each way in that was found."""

import asyncio
from contextlib import asynccontextmanager
from itertools import count

import pytest
from cameras import FFMPEG, IMAGE, LOCAL, STREAM

from sfglab.component import beside
from sfglab.fleet.decoder.node import AgentDecoder
from sfglab.fleet.decoder.streams import Route, routes_of_agent
from sfglab.fleet.discovery.screening import MAX_STREAMS, admitted
from sfglab.messages import default_message


def stream_info(topic=STREAM, **fields):
    info = default_message("sfglab_interfaces/msg/StreamInfo")
    info.topic, info.type = topic, FFMPEG
    for name, value in fields.items():
        setattr(info, name, value)
    return info


def metadata(*streams, agent="go2", **fields):
    sensor = default_message("sfglab_interfaces/msg/SensorInfo")
    sensor.name, sensor.streams = "camera_front", list(streams)
    whole = default_message("sfglab_interfaces/msg/AgentMetadata")
    whole.agent, whole.sensors = agent, [sensor]
    for name, value in fields.items():
        setattr(whole, name, value)
    return whole


@pytest.mark.parametrize(
    ("fields", "why"),
    [
        ({"decoded_topic": "/local/spot/camera_front/color/image_raw"}, "local scope"),
        ({"decoded_topic": "/global/go2/camera_front/color/image_raw"}, "local scope"),
        ({"decoded_topic": "/local/go2/../spot"}, "name"),
        ({"camera_info_topic": "/global/spot/camera_front/color/camera_info"}, "another agent's name"),
        ({"camera_info_topic": "/local/go2/camera_front/color/camera_info"}, "global scope"),
        ({"topic": "/global/spot/camera_front/color/ffmpeg"}, "another agent's name"),
        ({"topic": "/" + "x" * 60_000}, "topic"),
        ({"type": "x" * 300}, "type"),
        ({"type": "../../etc/passwd"}, "type"),
        ({"codec": "rm -rf"}, "codec"),
        ({"width": 2**32 - 1}, "pixels"),
        ({"rate_hz": float("nan")}, "Hz"),
        ({"rate_hz": float("inf")}, "Hz"),
    ],
    ids=lambda value: "" if isinstance(value, str) else str(value)[:60],
)
def test_a_stream_that_says_what_it_must_not_is_left_out_with_a_sentence_and_the_others_stay(fields, why):
    good = stream_info("/global/go2/camera_rear/color/ffmpeg")
    bad = metadata(stream_info(**fields), good)
    kept, (error,) = admitted(bad)
    assert [stream.topic for stream in kept.sensors[0].streams] == [good.topic]
    assert why in str(error)
    assert len(str(error)) < 1000
    assert "\n" not in str(error)
    assert [route.source_topic for route in routes_of_agent(bad)[0]] == [good.topic]


def test_of_two_of_one_name_the_first_counts_and_numbers_and_lengths_are_bounded():
    one = stream_info(decoded_topic="/local/go2/front")
    other = stream_info("/global/go2/camera_rear/color/ffmpeg", decoded_topic="/local/go2/front")
    kept, errors = admitted(metadata(one, other))
    assert (len(kept.sensors[0].streams), len(errors)) == (1, 1)
    derived = stream_info("/global/go2/camera_rear/color/ffmpeg", decoded_topic=LOCAL)
    routes, (error,) = routes_of_agent(metadata(stream_info(), derived))
    assert ([route.source_topic for route in routes], "another stream's" in str(error)) == ([STREAM], True)
    many = [stream_info(f"/global/go2/camera_front_{n}/color/ffmpeg") for n in range(1000)]
    kept, errors = admitted(metadata(*many, software=["x" * 1000, "a\nb", "sfglab 1"]))
    assert len(kept.sensors[0].streams) == MAX_STREAMS
    assert kept.software == ["sfglab 1"]
    assert "2 are not" in str(errors[-1])


class Pipe:
    """A pipeline process that does as it is told when the test lets it."""

    def __init__(self, owner, pid):
        self.owner, self.pid, self.status, self.orders = owner, pid, None, []

    def order(self, **values):
        self.orders.append(values)
        if values["do"] == "open":
            self.owner(self, {"is": "opened"})

    def signal(self, _):
        pass

    async def end(self):
        pass


class Pool:
    """Lends pipes."""

    def __init__(self):
        self.lent, self._pids = [], count(1)

    async def lend(self, owner):
        self.lent.append(Pipe(owner, next(self._pids)))
        return self.lent[-1]

    async def take_back(self, _):
        pass

    def close_all(self):
        for pipe in self.lent:
            if pipe.orders[-1]["do"] == "close":
                pipe.orders.append({"do": "nothing"})
                pipe.owner(pipe, {"is": "closed"})


@asynccontextmanager
async def decoding(world):
    """A decoder whose topic somebody wants; yields it, its pool, and a way to let some time pass."""
    async with world.node("decoder", host="pc") as node:
        node.create_subscription(IMAGE, LOCAL)
        pool = Pool()
        decoder = AgentDecoder(node, pool, offers=False)
        async with beside(decoder.run()) as (task,):
            yield decoder, pool, lambda: asyncio.sleep(0.5)
            assert not task.done(), task.exception()


def route(agent="go2", codec="h264"):
    return Route(agent=agent, source_topic=STREAM, source_type=FFMPEG, codec=codec, local_topic=LOCAL)


@pytest.mark.parametrize("sim", [{"seed": 1, "limit_s": 60}], indirect=True)
@pytest.mark.parametrize("back", ["h264", "hevc"], ids=["as it was", "changed"])
async def test_a_stream_that_returns_while_its_old_pipeline_still_leaves_is_decoded_again(sim, back):
    async with decoding(sim) as (decoder, pool, passes):
        for routes in ([route()], [], [], [route(codec=back)]):
            decoder.offer("go2", routes)
            await passes()
        pool.close_all()
        await passes()
        assert [pipe.orders[0]["stream"].codec for pipe in pool.lent] == ["h264", back]
        assert [status.state for status in decoder.status()] == ["RUNNING"]


@pytest.mark.parametrize("sim", [{"seed": 1, "limit_s": 60}], indirect=True)
async def test_who_came_second_is_decoded_when_the_first_has_gone(sim, caplog):
    async with decoding(sim) as (decoder, pool, passes):
        for agent in ("evil", "go2", "spot"):
            decoder.offer(agent, [route(agent)])
        await passes()
        assert "offered by evil already" in caplog.text
        decoder.offer("spot", [])
        decoder.offer("evil", [])
        await passes()
        pool.close_all()
        await passes()
        assert [pipe.orders[0]["stream"].agent for pipe in pool.lent] == ["evil", "go2"]
        decoder.offer("go2", [])
        await passes()
        pool.close_all()
        await passes()
        assert decoder.status() == ()
        assert not decoder._offered
