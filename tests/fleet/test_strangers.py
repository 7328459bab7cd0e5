"""What strangers say of themselves, and candidates that come late: one test for each way in that was found."""

import asyncio
from contextlib import asynccontextmanager
from itertools import count
from signal import SIGKILL

import pytest
from cameras import FFMPEG, IMAGE, LOCAL, STREAM, behind_router

from sfglab.component import beside
from sfglab.fleet.decoder.node import AgentDecoder
from sfglab.fleet.decoder.streams import Route, routes_of_agent
from sfglab.fleet.discovery.screening import MAX_STREAMS, admitted
from sfglab.fleet.router.frames import (
    MAX_CLAIMS,
    MAX_FRAME,
    TF_TYPE,
    FrameClaims,
    FrameClashError,
    Frames,
    TransformGate,
)
from sfglab.messages import default_message, deserialize, message_type, serialize
from sfglab.qos import LATCHED


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

    def signal(self, number):
        if number == SIGKILL:
            self.owner(self, {"is": "ended", "status": -number})

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


@pytest.mark.parametrize("sim", [{"seed": 1, "limit_s": 60}], indirect=True)
async def test_a_pipeline_process_that_hangs_is_replaced(sim, caplog, monkeypatch):
    look = "sfglab.fleet.decoder.node.HangWatch.look"
    monkeypatch.setattr(look, lambda _, pid: "it was stopped" if pid == 1 else "")
    async with decoding(sim) as (decoder, pool, _):
        decoder.offer("go2", [route()])
        await asyncio.sleep(5)
        assert [pipe.pid for pipe in pool.lent] == [1, 2]
        assert "it was stopped" in caplog.text


def tf(*pairs):
    made = []
    for parent, child in pairs:
        made.append(default_message("geometry_msgs/msg/TransformStamped"))
        made[-1].header.frame_id, made[-1].child_frame_id = parent, child
    return message_type(TF_TYPE)(transforms=made)


def passed(way, *pairs):
    """The children that pass a gate."""
    cdr = way(serialize(tf(*pairs)))
    return [] if cdr is None else [t.child_frame_id for t in deserialize(cdr, TF_TYPE).transforms]


@pytest.mark.parametrize(
    "pair",
    [
        ("odom", "base_link"),
        ("map", "base_link"),
        ("map", "/base_link"),
        ("map", "//base_link"),
        ("map", "go2"),
        ("base_link", "evil/arm"),
        ("map", "go2/odom"),
        ("map", "evil/" + "x" * MAX_FRAME),
        ("x" * 999, "evil/x"),
    ],
    ids=lambda pair: "-".join(pair)[:30],
)
def test_a_frame_of_others_that_could_mean_one_of_the_agents_stays_outside(pair, caplog):
    gate = TransformGate(Frames(agent="go2"))
    assert passed(gate.outward, ("odom", "base_link")) == ["go2/base_link"]
    evil = gate.inward("evil's router")
    for _ in range(3):
        assert passed(evil, pair, ("map", "evil/base"), ("earth", "map")) == ["evil/base", "map"]
    (said,) = [record.message for record in caplog.records]
    assert (gate.counts.clashed, "evil's router" in said, len(said) < 1000) == (3, True, True)


def test_a_frame_that_two_move_is_the_firsts_until_that_one_has_gone_and_both_are_named(caplog):
    gate = TransformGate(Frames(agent="go2", placed_by_others=frozenset({"odom"})))
    first, second = gate.inward("h/1"), gate.inward("h/2")
    for pair in (("map", "spot/odom"), ("map", "go2/odom"), ("earth", "map")):
        assert (passed(first, pair), passed(second, pair)) == ([pair[1]], [])
    assert all("h/1" in record.message and "h/2" in record.message for record in caplog.records)
    assert gate.keep_owners(frozenset({"h/2"})), "somebody else waits for them"
    assert passed(second, ("map", "spot/odom")) == ["spot/odom"]
    passed(gate.outward, ("earth", "world"))
    assert passed(second, ("earth", "world")) == [], "the agent's own nodes place it"
    assert ("go2 itself" in caplog.text, gate.counts.clashed) == (True, 5)


def test_claims_are_bounded_in_number_and_length():
    claims = FrameClaims()
    for number in range(MAX_CLAIMS):
        claims.claim(f"frame{number}", "evil")
    for frame in ("one_more", "x" * (MAX_FRAME + 1)):
        with pytest.raises(FrameClashError, match="evil has 1000") as caught:
            claims.claim(frame, "evil")
        assert len(str(caught.value)) < 1000
    claims.claim("one_more", "go2")
    assert not claims.keep(frozenset({"go2"}))
    assert list(claims._owners) == ["one_more"]


@pytest.mark.parametrize("sim", [{"seed": 1, "limit_s": 60}], indirect=True)
async def test_a_static_transform_that_was_refused_is_read_again_when_its_rival_has_gone(sim):
    node, router = behind_router(sim, "go2")
    async with sim.node("one", host="pc") as one, sim.node("two", host="pc") as two, beside(router.run()):
        heard = node.create_subscription(TF_TYPE, "/tf_static", qos=LATCHED)
        rival = one.create_publisher(TF_TYPE, "/tf_static", LATCHED)
        rival.publish(tf(("earth", "map")))
        await heard.take(10)
        two.create_publisher(TF_TYPE, "/tf_static", LATCHED).publish(tf(("world", "map")))
        await asyncio.sleep(5)
        assert router.status.clashed == 1
        rival.close()
        assert (await heard.take(20)).transforms[0].header.frame_id == "world"
