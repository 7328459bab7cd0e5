"""The pure parts: budgets, parameters, queues and sessions."""

from collections import deque
from dataclasses import replace
from itertools import accumulate

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
from sfglab.view.visualizers.images import Image

S = 1_000_000_000
IMAGE = "sensor_msgs/msg/Image"


@pytest.mark.parametrize(
    ("max_hz", "times_ns", "passes"),
    [
        (30, [n * S // 30 + (n % 3 - 1) * 6_000_000 for n in range(1, 99)], [True] * 98),  # jitter
        (10, [n * S // 30 for n in range(90)], [n % 3 == 0 for n in range(90)]),
        (1, [100 * S, 100 * S + 1, 5 * S], [True, False, True]),  # a clock that jumps back
    ],
)
def test_a_budget_passes_a_stream_of_its_rate_whole_and_a_faster_one_evenly(
    max_hz, times_ns, passes
):
    budget = RateBudget()
    assert [budget.allows(now_ns, max_hz) for now_ns in times_ns] == passes


@given(st.lists(st.integers(0, S // 5), min_size=1, max_size=200), st.floats(0.5, 200))
def test_a_budget_never_lets_more_pass_than_its_rate(gaps_ns, max_hz):
    budget, times_ns = RateBudget(), [*accumulate(gaps_ns)]
    passed = sum(budget.allows(now_ns, max_hz) for now_ns in times_ns)
    assert passed <= times_ns[-1] / S * max_hz + 2


def test_a_budget_follows_a_new_rate_at_once():
    budget = RateBudget()
    found = [budget.allows(now_ns, hz) for now_ns, hz in enumerate((1, 1, 1000, None))]
    assert found == [True, False, True, True]


@pytest.mark.parametrize(
    ("default", "bounds", "values"),
    [
        (1.0, {"minimum": 0, "maximum": 1}, (1.5, float("nan"), True, "1")),
        (3, {"minimum": 1}, (0, 1.0)),
        ("a", {}, (1,)),
        (True, {}, (1, None)),
    ],
)
def test_a_parameter_refuses_another_type_or_what_is_out_of_range(default, bounds, values):
    parameter = Parameter("x", default, "", **bounds)
    for value in values:
        with pytest.raises(
            InvalidValueError, match=r"x: (nothing is )?given.*, (allowed|needed): "
        ):
            parameter.check(value)


@given(st.lists(st.sampled_from(["offer", "take"]), max_size=200), st.integers(1, 5))
def test_a_slot_has_the_newest_of_its_queue_and_accounts_for_every_message(steps, queue):
    kind = type("Short", (Image,), {"queue": queue})
    slot, newest, lost = Slot(kind({"image": "/image"}), None), deque(maxlen=queue), 0
    for number, step in enumerate(steps):
        if step == "offer":
            slot.offer("image", number, number, now_ns=number)
            newest.append(number)
        elif newest:
            taken = slot.take()
            assert (taken.items, taken.stamp_ns) == ({"image": newest[0]}, newest.popleft())
            lost += taken.lost
            slot.shown += 1
            assert lost == slot.dropped
        else:
            assert slot.take() is None
        assert slot.waiting == len(newest)
    assert slot.received == steps.count("offer") == slot.shown + slot.waiting + slot.dropped


@pytest.mark.parametrize(
    ("act", "arguments", "told"),
    [
        (Session.add, ("imag", "/a"), r"visualizer: given 'imag', allowed: .*image"),
        (Session.remove, ("image-7",), "display: given 'image-7', allowed: image-1"),
        (Session.add, ("depth_cloud", "/a"), r"topics: .* each of depth, info, color \(optional\)"),
        (Session.add, ("image", {"bild": "/a"}), "image, topics: given .*, allowed: .* image"),
        (
            Session.tune,
            ("image-1", "opacity", 2),
            "opacity: given 2, allowed: a number from 0 to 1",
        ),
        (Session.tune, ("image-1", "bla", 1), "bla: given 1, allowed: the parameters opacity"),
        (Session.limit, ("image-1", 0), "max_hz: given 0"),
        (Session.request, ("image-1", "color", DEFAULT), "role: given 'color', allowed: image"),
    ],
)
def test_a_session_names_what_it_does_not_know_and_what_would_do(act, arguments, told):
    session = Session()
    display = session.add("image", "/a")
    with pytest.raises(InvalidValueError, match=told):
        act(session, *arguments)
    assert session.displays == (display,)


def test_a_new_request_keeps_the_rate_and_drops_what_waited():
    session = Session()
    display = session.add("compressed_video", "/video")
    session.limit(display.id, 3)
    display.slot.offer("video", 1, "x", now_ns=1)
    session.request(display.id, "video", LATCHED)
    assert (display.slot.max_hz, display.slot.waiting) == (3, 0)
    assert [qos for _, _, qos in display.inputs] == [LATCHED]


def test_what_could_be_shown_is_offered_once_and_only_when_its_partners_are_there():
    session = Session()
    depth, info = "/go2/depth/image_raw", "/go2/depth/camera_info"
    assert [offer.kind for offer in session.offers({depth: IMAGE})] == ["image"]
    topics = {depth: IMAGE, info: "sensor_msgs/msg/CameraInfo", "/chatter": "std_msgs/msg/String"}
    offers = session.offers(topics)
    assert {offer.kind: offer.topics for offer in offers} == {
        "image": {"image": depth},
        "camera_info": {"info": info},
        "depth_cloud": {"depth": depth, "info": info},
    }
    for offer in offers:
        session.add_offer(offer)
    assert session.offers(topics) == ()


def test_one_subscription_serves_the_most_demanding_display_and_takes_the_weakest_offer():
    shared = strongest([SENSOR_DATA, LATCHED, COMPRESSED_STREAM])
    assert (shared.reliability, shared.durability) == (LATCHED.reliability, LATCHED.durability)
    assert shared.depth == COMPRESSED_STREAM.depth
    assert requested(LATCHED, [LATCHED]) == LATCHED
    weakened = requested(LATCHED, [LATCHED, SENSOR_DATA])
    assert weakened == replace(SENSOR_DATA, depth=LATCHED.depth)
