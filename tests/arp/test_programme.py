"""The QoS programme: it is convex, its optimum is one, and its arithmetic is that of the simulation."""

import contextlib
from dataclasses import replace
from pathlib import Path
from random import Random

import numpy as np
import pytest

from sfglab.arp.link import link_of
from sfglab.arp.plan import assess, depths_for, plan_as_printed
from sfglab.arp.programme import pareto_front, plan_file
from sfglab.arp.topics import Topic, TopicFile, _Link, load_topics
from sfglab.errors import SfglabError
from sfglab.fields import bounds_of
from sfglab.qos import Durability, Reliability
from sfglab.rtps import CYCLONE_DDS, FAST_DDS, PRESETS, Flow, Medium, Scenario, run

PAPER_B = load_topics(Path(__file__).parents[2] / "data" / "qos" / "paper_b.yaml")
ASYNC = PRESETS["fast_dds_async"]
VENDORS = pytest.mark.parametrize("vendor", [FAST_DDS, CYCLONE_DDS, ASYNC], ids=lambda v: v.name)
LATCHED = Durability.TRANSIENT_LOCAL
HOSTS = ("station", "robot2", "robot3")
SAME = ("name", "source", "target", "size_bytes", "cached", "change_s")
"""Names of values that a topic and its flow in the reliability model have in common."""


def topic(name: str = "/a", **values) -> Topic:
    usual = {"source": "robot", "target": "station", "size_bytes": 24}
    return Topic(name=name, **usual | values)


def equal_topics(count: int, **values) -> list[Topic]:
    return [topic(f"/t{i}", **values) for i in range(count)]


def given(topics, medium, vendor, **limits) -> TopicFile:
    return TopicFile(topics=tuple(topics), medium=medium, vendor=vendor, **limits)


def plan(topics, medium, vendor, *, latency_price_hz=None, **limits):
    return plan_file(given(topics, medium, vendor, **limits), latency_price_hz=latency_price_hz)


def rates_of(planned):
    return np.array([part.rate_hz for part in planned.topics])


def simulated(planned, *, seed: int = 3, duration_s: float = 40.0):
    """Run a plan, of topics with one receiver each, in the reliability model, with random phases."""
    draw = np.random.default_rng(seed)
    flows = []
    for part in planned.topics:
        values = {name: getattr(part.topic, name) for name in SAME}
        values |= {"rate_hz": part.rate_hz, "phase_s": draw.uniform(0, 1 / part.rate_hz)}
        flows.append(Flow(qos=part.qos, **values))
    given = {"medium": planned.medium, "vendor": planned.vendor, "duration_s": duration_s}
    return run(Scenario(flows=tuple(flows), **given), seed=seed)


def assessed(topics, medium, vendor, rates_hz, depths):
    rates_hz, depths = np.asarray(rates_hz), np.asarray(depths)
    return assess(given(topics, medium, vendor), rates_hz, depths, method="by hand")


def loss_of(outcome) -> float:
    return 1 - np.concatenate([flow.delivered for flow in outcome.flows.values()]).mean()


def latency_of(outcome) -> float:
    return np.mean([flow.latency_ns.mean() for flow in outcome.flows.values()]) / 1e9


# --- The programme -----------------------------------------------------------------------------


@pytest.mark.parametrize("target", ["station", HOSTS], ids=["one", "three"])
def test_equal_topics_share_the_capacity_equally_up_to_the_border_of_what_is_feasible(target):
    """A topic with several receivers costs as much as one topic for each of them."""
    medium, topics = Medium(contention=0), equal_topics(4, target=target)
    link = link_of(given(equal_topics(4 * len(topics[0].targets)), medium, CYCLONE_DDS))
    each_hz = 0.9 / (link.data_s + link.acknack_share * link.acknack_s).sum()
    feasible, infeasible = (
        [replace(one, rate_min_hz=share * each_hz) for one in topics] for share in (0.999, 1.1)
    )
    found = plan(feasible, medium, CYCLONE_DDS, latency_price_hz=0.0)
    assert rates_of(found) == pytest.approx(np.full(4, each_hz), rel=1e-3)
    with pytest.raises(
        SfglabError, match=r"allowed is 0.9, so 0.09 is lacking; .*\(to 0.91 of them"
    ):
        plan(infeasible, medium, CYCLONE_DDS)


ALONE = topic("/alone", target="other", change_s=0.02)
CROWD = equal_topics(30, source="crowd", size_bytes=1400, change_s=0.02)
WEIGHED = [replace(one, weight=1 + i % 3) for i, one in enumerate(PAPER_B.topics)]


@pytest.mark.parametrize(
    ("topics", "medium", "vendor"),
    [
        (PAPER_B.topics, Medium(), FAST_DDS),
        (WEIGHED, Medium(), CYCLONE_DDS),
        (PAPER_B.topics, Medium(), ASYNC),
        ([ALONE, *CROWD], Medium(shared=False, rate_bps=10e6), CYCLONE_DDS),
    ],
    ids=["Fast DDS", "weights", "asynchronous", "a host with time to spare"],
)
def test_no_neighbour_of_the_optimum_that_takes_no_more_is_better(topics, medium, vendor):
    def worth(planned):
        return planned.freshness - 30.0 * planned.latency_s

    found = plan(topics, medium, vendor, latency_price_hz=30.0)
    depths, rng = [part.depth for part in found.topics], np.random.default_rng(1)
    for size in np.repeat([1e-3, 1e-2, 0.05], 40):
        rates_hz = rates_of(found) * (1 + size * rng.standard_normal(len(topics)))
        # No more than the losses let through.
        rates_hz = np.clip(rates_hz, 1, rates_of(found).max())
        other = assessed(topics, medium, vendor, rates_hz, depths)
        assert other.utilisation > found.utilisation or worth(other) <= worth(found) + 1e-5


def ends_of_bounds():
    """Yield values by the name of a field, each at an end of what it may be."""
    for kind in (Topic, _Link):
        for name, limits in bounds_of(kind).items():
            for end in (max(limits.low, 1e-9), min(limits.high, 1e9)):
                value = int(end) if name in ("size_bytes", "queue_frames") else end
                if value in limits and name != "rate_min_hz":
                    yield {name: value}


@pytest.mark.parametrize("values", [*ends_of_bounds()], ids=repr)
def test_every_legal_value_has_a_plan_within_its_limits_or_an_error_of_ours(values):
    draw = Random(repr(values))
    of_topic = values.keys() <= bounds_of(Topic).keys()
    usual = {"rate_min_hz": 1e-9, "reliability": draw.choice([*Reliability])}
    usual |= {"durability": draw.choice([*Durability]), "cached": draw.random() < 0.3}
    topics = topic("/a", **usual | (values if of_topic else {})), topic("/b", rate_min_hz=1e-9)
    medium = _Link(**{} if of_topic else values).medium
    with contextlib.suppress(SfglabError), np.errstate(all="ignore"):
        found = plan(topics, medium, draw.choice([*PRESETS.values()]), latency_price_hz=10.0)
        assert found.utilisation <= 0.9 + 1e-5
        for part in found.topics:
            assert part.topic.rate_min_hz <= part.rate_hz <= part.topic.rate_max_hz
            assert 0 < part.latency_s < np.inf
            assert 0 <= part.up_to_date <= 1
            assert 0 <= part.loss <= 0.99
            assert part.deadline_ns is None or part.deadline_ns > 0


@VENDORS
def test_along_the_front_latency_costs_freshness_and_the_default_is_its_best_point_inside(vendor):
    front = pareto_front(replace(PAPER_B, vendor=vendor))
    values = [(point.freshness, point.latency_s) for point in front]
    assert (np.diff(values, axis=0) < (1e-6, 1e-8)).all()
    assert front[0].latency_s > 1.15 * front[-1].latency_s
    shares = [point.up_to_date for point in front]
    chosen = plan(PAPER_B.topics, PAPER_B.medium, vendor)
    assert chosen.up_to_date == max(shares) > max(shares[0], shares[-1])


def test_behind_a_local_cache_slow_values_are_read_often_and_sent_seldom():
    topics = [replace(asked, cached=True) for asked in PAPER_B.topics]
    plain, cached = (plan(each, PAPER_B.medium, FAST_DDS) for each in (PAPER_B.topics, topics))
    assert cached.up_to_date > plain.up_to_date
    sent = sum(len(flow.fate) for flow in simulated(cached).flows.values())
    change_hz = 1 / np.array([asked.change_s for asked in topics])
    found_new = 1 - np.exp(-change_hz / rates_of(cached))
    assert sent / 40 == pytest.approx(rates_of(cached) @ found_new, rel=0.05)


BIG = topic("/big", rate_min_hz=900, size_bytes=1400)


@pytest.mark.parametrize(
    ("topics", "price", "message"),
    [
        ([topic()], 1e300, "solver CLARABEL ended"),
        ([topic("/cam", size_bytes=6_220_800)], 0.0, "'/cam': given '6220800 bytes in 4204 frames"),
        ([topic(), BIG], 0.0, "time of the medium.*lacking.*/big, /a"),
    ],
)
def test_what_has_no_plan_is_refused(topics, price, message):
    with pytest.raises(SfglabError, match=message):
        plan(topics, Medium(), FAST_DDS, latency_price_hz=price)


# --- The arithmetic and the simulation ---------------------------------------------------------


def test_depth_holds_what_is_published_during_the_repairs_and_deadline_is_its_length():
    """By hand: 2 rounds of 1/50 + 0.01 s and the frames' time are 3.08 samples, so 4, and the lost one."""
    asked = topic(rate_max_hz=50, durability=LATCHED)
    link = link_of(given([asked], Medium(contention=0), FAST_DDS))
    assert depths_for(link, np.array([50.0]), residual_loss=1e-4).tolist() == [5]
    for depth, deadline_ns in ((5, 100_000_000), (1, 40_000_000)):  # two periods at least
        planned = assessed([asked], Medium(), FAST_DDS, [50.0], [depth])
        assert planned.topics[0].qos.deadline_ns == deadline_ns


@pytest.mark.parametrize("rate_max_hz", [100, 500])
def test_with_fast_dds_ours_is_sooner_than_the_published_optimum_and_loses_as_little(rate_max_hz):
    """The published depths lose nothing where the medium is not overloaded: they wait for seconds instead."""
    file = PAPER_B.limited_to(rate_max_hz)
    ours, published = plan_file(file), plan_as_printed(file)
    one, other = (simulated(planned, duration_s=12.0) for planned in (ours, published))
    assert 20 * latency_of(one) <= latency_of(other)
    assert loss_of(one) <= max(loss_of(other), 4e-4)
    assert 0.4 < latency_of(other) / published.latency_s < 1


@VENDORS
@pytest.mark.parametrize("price", [10.0, 300.0])
def test_expected_latency_airtime_and_freshness_are_as_simulated(vendor, price):
    """Queues are reckoned for random arrivals, so latency lies above, up to 80 % of the air by less than twofold."""
    planned = plan(PAPER_B.topics, PAPER_B.medium, vendor, latency_price_hz=price)
    outcome = simulated(planned)
    assert 0.5 < latency_of(outcome) / planned.latency_s < 1.05
    air = outcome.counts["airtime_ns"] / 40e9
    stretched = 1 + 3 * planned.medium.contention  # by three hosts besides the sender
    assert 0.9 < air * stretched / planned.utilisation < 1.2
    assert up_to_date_of(planned, outcome) == pytest.approx(planned.up_to_date, abs=0.015)


def up_to_date_of(planned, outcome, duration_s: float = 40.0) -> float:
    """Return the share of time in which readers had the true value, mean over the topics."""
    shares = []
    for part, flow in zip(planned.topics, outcome.flows.values(), strict=True):
        change_s, received_s = part.topic.change_s, flow.received_ns[flow.delivered] / 1e9
        ends_s = np.stack((received_s, np.append(received_s[1:], duration_s)))
        # A value of age a is still true with probability exp(-a / t).
        true = np.exp((flow.published_ns[flow.delivered] / 1e9 - ends_s) / change_s)
        shares.append(change_s * (true[0] - true[1]).sum() / duration_s)
    return np.mean(shares)


def test_the_planned_loss_counts_all_rounds_that_a_history_holds_and_readers_know_less_by_it():
    """Half of the frames are lost, and so three quarters of the rounds: 0.5 (3 / 4)^k after k rounds."""
    asked = topic(rate_max_hz=20, change_s=0.1, durability=LATCHED)
    found = []
    for depth in (1, 2, 10, 20, 40):
        planned = assessed([asked], Medium(loss=0.5, contention=0), CYCLONE_DDS, [20.0], [depth])
        loss = planned.topics[0].loss
        rounds = np.log(2 * loss) / np.log(3 / 4)
        assert rounds == pytest.approx(round(rounds), abs=1e-6)
        found.append((-loss, planned.up_to_date))
    assert (np.diff(found, axis=0) > 0).all()
    assert found[0][0] < -0.2


def test_the_papers_depth_is_a_whole_number_where_the_problem_has_one():
    """T_a = 2, Rmax = 1000: R = 1000 / 2 - 1 and D = 5000 R / 1000 - 1 = 2494."""
    file = TopicFile(topics=tuple(equal_topics(2)), agents=("robot",))
    (first, _) = plan_as_printed(file).topics
    assert (first.rate_hz, first.depth) == (499, 2494)


def test_the_planned_depth_repairs_and_what_no_depth_can_keep_is_in_the_planned_loss():
    """10 % loss: a TRANSIENT_LOCAL history keeps all, a VOLATILE one of Fast DDS as much as planned."""
    latched, volatile = (
        plan(equal_topics(4, rate_max_hz=50, durability=one), Medium(loss=0.1), FAST_DDS)
        for one in (LATCHED, Durability.VOLATILE)
    )
    assert loss_of(simulated(latched)) < 2e-3
    assert volatile.topics[0].loss == pytest.approx(0.1 * (1 - 0.9**3), rel=0.01)
    assert 0 < loss_of(simulated(volatile)) < volatile.topics[0].loss


@pytest.mark.parametrize(
    ("vendor", "depth", "durability"),
    [
        (FAST_DDS, 2, Durability.VOLATILE),
        (FAST_DDS, 4, Durability.VOLATILE),
        (FAST_DDS, 30, LATCHED),
        (CYCLONE_DDS, 30, Durability.VOLATILE),
    ],
)
@pytest.mark.parametrize("rate_hz", [0.1, 1, 5, 20, 80])
def test_of_one_topic_delays_and_losses_are_as_simulated(vendor, depth, durability, rate_hz):
    """Heartbeats ride with one sample in two or four, or with each, so that depth delays nothing."""
    asked = topic(durability=durability)
    planned = assessed([asked], Medium(contention=0), vendor, [rate_hz], [depth])
    outcome = simulated(planned, duration_s=300_000 / rate_hz)
    way_s = link_of(given([asked], planned.medium, vendor)).way_s[0]
    assert planned.latency_s - way_s == pytest.approx(latency_of(outcome) - way_s, rel=0.25)
    assert planned.topics[0].loss > loss_of(outcome) - 5e-5


@pytest.mark.parametrize(("size_bytes", "frames"), [(24, 1), (1384, 1), (1385, 2), (100_000, 68)])
def test_a_large_message_takes_several_frames_and_is_lost_with_any_of_them(size_bytes, frames):
    medium = Medium(loss=0.01, rate_bps=1e12)
    link = link_of(given([topic(size_bytes=size_bytes)], medium, FAST_DDS))
    assert link.loss[0] == pytest.approx(1 - 0.99**frames)
    assert link.way_s[0] == pytest.approx(frames * medium.overhead_s, rel=0.01)
