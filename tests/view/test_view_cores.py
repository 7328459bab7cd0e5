"""The pure parts: budgets, parameters, queues, entities, sessions."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfglab.errors import InvalidValueError
from sfglab.names import Resource, RosFqnBuilder, Scope
from sfglab.qos import COMPRESSED_STREAM, DEFAULT, LATCHED, SENSOR_DATA, Durability, Reliability
from sfglab.view import Approximate, Exact, Independent, Input, Parameter, Visualizer
from sfglab.view.bridge import requested, strongest
from sfglab.view.session import Changed, Session
from sfglab.view.slot import RateBudget, Slot
from sfglab.view.visualizer import agent_root, entity_of_topic

S = 1_000_000_000
IMAGE = "sensor_msgs/msg/Image"


@given(st.lists(st.integers(0, S // 5), max_size=200), st.floats(0.5, 200))
def test_a_budget_never_lets_more_pass_than_its_rate(gaps_ns, max_hz):
    budget, now, passed = RateBudget(max_hz), 0, 0
    for gap in gaps_ns:
        now += gap
        passed += budget.allows(now)
    assert passed <= now / S * max_hz + 2
    assert passed + budget.dropped == len(gaps_ns)


def test_a_stream_within_the_budget_passes_whole_and_thirty_hertz_of_ten_is_every_third():
    budget = RateBudget(30)
    period = S // 30
    jitter = [0, 5, -6, 3, -4, 6, -5, 2, -6, 6] * 30
    assert all(budget.allows(i * period + j * 1_000_000) for i, j in enumerate(jitter))
    budget = RateBudget(10)
    assert [budget.allows(i * S // 30) for i in range(90)] == [i % 3 == 0 for i in range(90)]


def test_a_budget_follows_a_clock_that_jumps_back_and_a_new_rate():
    budget = RateBudget(1)
    assert [budget.allows(t) for t in (100 * S, 100 * S + 1, 5 * S)] == [True, False, True]
    budget.max_hz = None
    assert budget.allows(5 * S)
    with pytest.raises(InvalidValueError, match="max_hz: given 0"):
        budget.max_hz = 0


PARAMETERS = {
    "opacity": Parameter(name="opacity", default=1.0, minimum=0, maximum=1, help=""),
    "count": Parameter(name="count", default=3, minimum=1, help=""),
    "mode": Parameter(name="mode", default="a", choices=("a", "b"), help=""),
    "on": Parameter(name="on", default=True, help=""),
}


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("opacity", value) for value in (1.5, float("nan"), True, "1")),
        *(("count", value) for value in (0, 1.0)),
        ("mode", "c"),
        *(("on", value) for value in (1, None)),
    ],
)
def test_a_parameter_refuses_another_type_or_what_is_out_of_range(name, value):
    with pytest.raises(InvalidValueError, match=f"{name}: (nothing is )?given.*, allowed: "):
        PARAMETERS[name].check(value)


def test_a_whole_number_is_a_number_and_stays_exact():
    assert PARAMETERS["opacity"].check(1) == 1.0
    assert isinstance(PARAMETERS["opacity"].check(1), float)
    assert PARAMETERS["count"].check(10**18) == 10**18


@given(st.lists(st.sampled_from(["offer", "take"]), max_size=200), st.integers(1, 5))
def test_a_slot_never_holds_more_than_its_queue_and_accounts_for_every_message(steps, queue):
    slot = Slot(("image",), policy=Independent(), max_hz=None, queue=queue)
    lost = taken_sets = 0
    for number, step in enumerate(steps):
        if step == "offer":
            slot.offer("image", number, number, now_ns=number)
        elif (taken := slot.take()) is not None:
            lost += taken.lost
            slot.count_shown()
            taken_sets += 1
        assert len(slot) <= queue
    counts = slot.counts
    assert counts.received == steps.count("offer") == counts.shown + counts.waiting + counts.dropped
    assert counts.shown == taken_sets
    assert lost <= counts.dropped


def test_a_queue_of_one_shows_the_latest_and_says_how_many_were_passed_over():
    slot = Slot(("image",), policy=Independent(), max_hz=None, queue=1)
    for number in range(5):
        slot.offer("image", number, number, now_ns=number)
    taken = slot.take()
    assert (taken.items, taken.lost) == ({"image": 4}, 4)
    slot.offer("image", 5, 5, now_ns=5)
    assert slot.take().lost == 0
    assert slot.take() is None


def test_topics_of_the_schema_stand_below_their_agent_and_others_keep_their_names():
    topic = str(
        RosFqnBuilder().scope(Scope.GLOBAL).agent("go2").resource(Resource.BATTERY_STATE).build()
    )
    assert entity_of_topic(topic) == "/agents/go2/global/battery_state"
    assert entity_of_topic("/local/go2/imu/imu") == "/agents/go2/local/imu/imu"
    assert entity_of_topic("/global/agent_heartbeat") == "/global/agent_heartbeat"
    assert entity_of_topic("/chatter") == "/chatter"
    assert entity_of_topic(topic).startswith(agent_root("go2"))


def test_a_session_adds_tunes_limits_and_removes_and_tells_it():
    session, heard = Session(), []
    first = session.add("image", "/a")
    session.listen(lambda change: heard.append((change.what, change.display.id)))
    second = session.add("image", {"image": "/b"}, {"opacity": 0.5})
    session.tune(second.id, "opacity", 0.25)
    session.limit(second.id, 5)
    session.enable(first.id, enabled=False)
    session.remove(second.id)
    told = [Changed.ADDED, *[Changed.TUNED] * 3, Changed.REMOVED]
    assert [what for what, _ in heard] == told[:1] + told
    assert second.visualizer.settings["opacity"] == 0.25
    assert [d.id for d in session.displays] == [first.id]
    assert first.id != second.id


def test_a_session_names_what_it_does_not_know_and_what_would_do():
    session = Session()
    with pytest.raises(InvalidValueError, match=r"visualizer: given 'imag', allowed: .*image"):
        session.add("imag", "/a")
    with pytest.raises(InvalidValueError, match=r"display: given 'image-7', allowed: none"):
        session.remove("image-7")
    with pytest.raises(InvalidValueError, match=r"topics: .* with all of: info"):
        session.add("depth_cloud", "/depth")
    with pytest.raises(InvalidValueError, match=r"role: given 'bild'"):
        session.add("image", {"bild": "/a"})
    display = session.add("image", "/a")
    with pytest.raises(InvalidValueError, match=r"opacity: given 2, allowed: numbers from 0 to 1"):
        session.tune(display.id, "opacity", 2)
    assert display.visualizer.settings["opacity"] == 1.0
    with pytest.raises(InvalidValueError, match=r"bla: given 1, allowed: a parameter: opacity"):
        session.tune(display.id, "bla", 1)
    assert len(session.displays) == 1


def test_rewiring_keeps_the_rate_and_a_display_that_was_off_is_told_what_it_missed():
    session = Session()
    display = session.add("depth_cloud", {"depth": "/d", "info": "/i"})
    declared = display.inputs[1][2]
    session.limit(display.id, 3)
    display.slot.offer("depth", 1, "x", now_ns=1)
    session.rewire(display.id, qos={"depth": COMPRESSED_STREAM}, sync=Exact(depth=2))
    assert display.slot.budget.max_hz == 3
    assert display.slot.counts.waiting == 0
    assert [qos for _, _, qos in display.inputs] == [COMPRESSED_STREAM, declared]
    with pytest.raises(InvalidValueError, match="role: given 'color'"):
        session.rewire(display.id, qos={"color": DEFAULT})
    assert isinstance(session.display(display.id).sync, Exact)
    session = Session()
    display = session.add("compressed_video", "/video")
    session.enable(display.id, enabled=False)
    session.enable(display.id, enabled=True)
    display.slot.offer("video", 1, "x", now_ns=1)
    assert display.slot.take().lost == 1


def test_what_could_be_shown_is_offered_once_and_only_when_its_partners_are_there():
    session = Session()
    depth = "/local/go2/camera_front/aligned_depth/image_raw"
    info = "/local/go2/camera_front/aligned_depth/camera_info"
    assert [o.kind for o in session.offers({depth: IMAGE})] == ["image"]
    topics = {depth: IMAGE, info: "sensor_msgs/msg/CameraInfo", "/chatter": "std_msgs/msg/String"}
    offers = session.offers(topics)
    assert {o.kind for o in offers} == {"image", "camera_info", "depth_cloud"}
    (cloud,) = (o for o in offers if o.kind == "depth_cloud")
    assert cloud.topics == {"depth": depth, "info": info}
    for offer in offers:
        session.add(offer.kind, offer.topics)
    assert session.offers(topics) == ()


def test_what_is_requested_matches_the_weakest_offer_and_serves_the_most_demanding_display():
    assert requested(LATCHED, [LATCHED]) == LATCHED
    weakened = requested(LATCHED, [LATCHED, SENSOR_DATA])
    assert weakened.reliability is Reliability.BEST_EFFORT
    assert weakened.durability is Durability.VOLATILE
    assert requested(DEFAULT, []) == DEFAULT
    shared = strongest([SENSOR_DATA, LATCHED, COMPRESSED_STREAM])
    assert (shared.reliability, shared.durability) == (
        Reliability.RELIABLE,
        Durability.TRANSIENT_LOCAL,
    )
    assert shared.depth == COMPRESSED_STREAM.depth
    assert strongest([SENSOR_DATA]) == SENSOR_DATA


def test_a_visualizer_declares_before_it_is_made():
    class Own(Visualizer):
        name = "own"
        inputs = (Input(role="x", type="std_msgs/msg/String"),)
        sync = Approximate(slop_ns=5)

        def show(self, update, canvas):
            canvas.log(self.entity, update.only.data)

    assert Own({"x": "/global/go2/state"}).agent == "go2"
    assert Own({"x": "/a"}).tick(0, None) is None
    assert Session().add(Own, "/a").sync == Approximate(slop_ns=5)
