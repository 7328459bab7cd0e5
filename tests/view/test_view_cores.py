"""The pure parts: budgets, parameters, queues, entities, sessions."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfglab.bus.listing import requested
from sfglab.errors import InvalidValueError
from sfglab.qos import COMPRESSED_STREAM, DEFAULT, LATCHED, SENSOR_DATA
from sfglab.view import Parameter
from sfglab.view.bridge import strongest
from sfglab.view.session import Session
from sfglab.view.slot import RateBudget, Slot
from sfglab.view.visualizer import entity_of_topic
from sfglab.view.visualizers.images import Image

S = 1_000_000_000
IMAGE = "sensor_msgs/msg/Image"


@given(st.lists(st.integers(0, S // 5), max_size=200), st.floats(0.5, 200))
def test_a_budget_never_lets_more_pass_than_its_rate(gaps_ns, max_hz):
    budget, now, passed = RateBudget(), 0, 0
    for gap in gaps_ns:
        now += gap
        passed += budget.allows(now, max_hz)
    assert passed <= now / S * max_hz + 2


def test_a_stream_within_the_budget_passes_whole_and_thirty_hertz_of_ten_is_every_third():
    budget, jitter = RateBudget(), [0, 5, -6, 3, -4, 6, -5, 2, -6, 6] * 30
    assert all(budget.allows(i * S // 30 + j * 1_000_000, 30) for i, j in enumerate(jitter))
    budget = RateBudget()
    assert [budget.allows(i * S // 30, 10) for i in range(90)] == [i % 3 == 0 for i in range(90)]


def test_a_budget_follows_a_clock_that_jumps_back_and_a_new_rate():
    budget = RateBudget()
    assert [budget.allows(t, 1) for t in (100 * S, 100 * S + 1, 5 * S)] == [True, False, True]
    assert [budget.allows(5 * S + 1, hz) for hz in (1, 1000, None)] == [False, True, True]


NUMBER = Parameter("x", 1.0, "", minimum=0, maximum=1)
COUNT = Parameter("x", 3, "", minimum=1)
MODE = Parameter("x", "a", "", choices=("a", "b"))
SWITCH = Parameter("x", True, "")


@pytest.mark.parametrize(
    ("parameter", "value"),
    [
        *((NUMBER, value) for value in (1.5, float("nan"), True, "1")),
        *((COUNT, value) for value in (0, 1.0)),
        (MODE, "c"),
        *((SWITCH, value) for value in (1, None)),
    ],
)
def test_a_parameter_refuses_another_type_or_what_is_out_of_range(parameter, value):
    with pytest.raises(InvalidValueError, match=r"x: (nothing is )?given.*, allowed: "):
        parameter.check(value)


def queue_of(size):
    kind = type("Short", (Image,), {"queue": size})
    return Slot(kind({"image": "/image"}), None)


@given(st.lists(st.sampled_from(["offer", "take"]), max_size=200), st.integers(1, 5))
def test_a_slot_never_holds_more_than_its_queue_and_accounts_for_every_message(steps, queue):
    slot = queue_of(queue)
    lost = 0
    for number, step in enumerate(steps):
        if step == "offer":
            slot.offer("image", number, number, now_ns=number)
        elif (taken := slot.take()) is not None:
            lost += taken.lost
            slot.shown += 1
        assert slot.waiting <= queue
    assert slot.received == steps.count("offer") == slot.shown + slot.waiting + slot.dropped
    assert lost <= slot.dropped


def test_a_queue_of_one_shows_the_latest_and_says_how_many_were_passed_over():
    slot = queue_of(1)
    for number in range(5):
        slot.offer("image", number, number, now_ns=number)
    assert slot.take() == ({"image": 4}, 4, 4)
    slot.offer("image", 5, 5, now_ns=5)
    assert slot.take().lost == 0
    assert slot.take() is None


@pytest.mark.parametrize(
    ("topic", "entity"),
    [
        ("/global/go2/battery_state", "/agents/go2/global/battery_state"),
        ("/local/go2/imu/imu", "/agents/go2/local/imu/imu"),
        ("/global/agent_heartbeat", "/global/agent_heartbeat"),
        ("/chatter", "/chatter"),
    ],
)
def test_topics_of_the_schema_stand_below_their_agent_and_others_keep_their_names(topic, entity):
    assert entity_of_topic(topic) == entity


@pytest.mark.parametrize(
    ("act", "told"),
    [
        (lambda s: s.add("imag", "/a"), r"visualizer: given 'imag', allowed: .*image"),
        (lambda s: s.remove("image-7"), "display: given 'image-7', allowed: image-1"),
        (
            lambda s: s.add("depth_cloud", "/a"),
            r"depth_cloud, topics: .* each of depth, info, color \(optional\)",
        ),
        (lambda s: s.add("image", {"bild": "/a"}), "image, topics: given .*, allowed: .* image"),
        (
            lambda s: s.tune("image-1", "opacity", 2),
            "opacity: given 2, allowed: a number from 0 to 1",
        ),
        (lambda s: s.tune("image-1", "bla", 1), "bla: given 1, allowed: a parameter: opacity"),
        (lambda s: s.limit("image-1", 0), "max_hz: given 0"),
        (lambda s: s.request("image-1", "color", DEFAULT), "role: given 'color', allowed: image"),
    ],
)
def test_a_session_names_what_it_does_not_know_and_what_would_do(act, told):
    session = Session()
    display = session.add("image", "/a")
    with pytest.raises(InvalidValueError, match=told):
        act(session)
    assert session.displays == (display,)
    assert display.visualizer.settings["opacity"] == 1.0


def test_a_new_request_keeps_the_rate_and_a_display_that_was_off_is_told_what_it_missed():
    session = Session()
    display = session.add("depth_cloud", {"depth": "/d", "info": "/i"})
    declared = display.inputs[1][2]
    session.limit(display.id, 3)
    display.slot.offer("depth", 1, "x", now_ns=1)
    session.request(display.id, "depth", COMPRESSED_STREAM)
    assert (display.slot.max_hz, display.slot.waiting) == (3, 0)
    assert [qos for _, _, qos in display.inputs] == [COMPRESSED_STREAM, declared]
    display = session.add("compressed_video", "/video")
    for enabled in (False, True):
        session.enable(display.id, enabled=enabled)
    display.slot.offer("video", 1, "x", now_ns=1)
    assert display.slot.take().lost == 1


def test_what_could_be_shown_is_offered_once_and_only_when_its_partners_are_there():
    session = Session()
    depth = "/local/go2/camera_front/aligned_depth/image_raw"
    info = "/local/go2/camera_front/aligned_depth/camera_info"
    assert [offer.kind for offer in session.offers({depth: IMAGE})] == ["image"]
    topics = {depth: IMAGE, info: "sensor_msgs/msg/CameraInfo", "/chatter": "std_msgs/msg/String"}
    found = {offer.kind: offer.topics for offer in session.offers(topics)}
    assert found == {
        "image": {"image": depth},
        "camera_info": {"info": info},
        "depth_cloud": {"depth": depth, "info": info},
    }
    for kind, bound in found.items():
        session.add(kind, bound)
    assert session.offers(topics) == ()


def test_one_subscription_serves_the_most_demanding_display():
    shared = strongest([SENSOR_DATA, LATCHED, COMPRESSED_STREAM])
    assert (shared.reliability, shared.durability) == (LATCHED.reliability, LATCHED.durability)
    assert shared.depth == COMPRESSED_STREAM.depth
    assert strongest([SENSOR_DATA]) == SENSOR_DATA


def test_what_is_requested_matches_the_weakest_offer():
    assert requested(LATCHED, [LATCHED]) == LATCHED
    weakened = requested(LATCHED, [LATCHED, SENSOR_DATA])
    assert weakened.reliability is SENSOR_DATA.reliability
    assert weakened.durability is SENSOR_DATA.durability
