"""The QoS programme: it is convex, its optimum is one, and its arithmetic is that of the simulation."""

import contextlib
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from sfglab.arp.link import link_of
from sfglab.arp.plan import assess, depths_for, plan_as_printed
from sfglab.arp.programme import pareto_front, plan_file
from sfglab.arp.topics import Topic, TopicFile, _Link, load_topics
from sfglab.errors import SfglabError
from sfglab.fields import bounds_of
from sfglab.qos import Durability
from sfglab.rtps import CYCLONE_DDS, FAST_DDS, PRESETS, Flow, Medium, Scenario, run

PAPER_B = load_topics(Path(__file__).parents[2] / "data" / "qos" / "paper_b.yaml")
ASYNC = PRESETS["fast_dds_async"]
VENDORS = pytest.mark.parametrize("vendor", [FAST_DDS, CYCLONE_DDS, ASYNC], ids=lambda v: v.name)
LATCHED = Durability.TRANSIENT_LOCAL
HOSTS = ("station", "robot2", "robot3")


def topic(name: str = "/a", **values) -> Topic:
    usual = {"source": "robot", "target": "station", "size_bytes": 24}
    return Topic(name=name, **usual | values)


def given(topics, medium, vendor, **limits) -> TopicFile:
    return TopicFile(topics=tuple(topics), medium=medium, vendor=vendor, **limits)


def plan(topics, medium, vendor, *, latency_price_hz=None, **limits):
    return plan_file(given(topics, medium, vendor, **limits), latency_price_hz=latency_price_hz)


def simulated(planned, *, duration_s: float = 40.0):
    """Run a plan, of topics with one receiver each, in the reliability model, with random phases."""
    draw, flows = np.random.default_rng(3), []
    for part in planned.topics:
        asked = part.topic
        flow = Flow(
            name=asked.name,
            source=asked.source,
            target=asked.target,
            size_bytes=asked.size_bytes,
            cached=asked.cached,
            change_s=asked.change_s,
            rate_hz=part.rate_hz,
            phase_s=draw.uniform(0, 1 / part.rate_hz),
            qos=part.qos,
        )
        flows.append(flow)
    of_plan = {"medium": planned.medium, "vendor": planned.vendor}
    return run(Scenario(flows=tuple(flows), duration_s=duration_s, **of_plan), seed=3)


def assessed(topics, medium, vendor, rates_hz, depths):
    rates_hz, depths = np.asarray(rates_hz), np.asarray(depths)
    return assess(given(topics, medium, vendor), rates_hz, depths, method="by hand")


def loss_of(outcome) -> float:
    return 1 - np.concatenate([flow.delivered for flow in outcome.flows.values()]).mean()


def latency_of(outcome) -> float:
    return np.mean([flow.latency_ns.mean() for flow in outcome.flows.values()]) / 1e9


# --- The programme -----------------------------------------------------------------------------


WEIGHED = [replace(one, weight=1 + i % 3) for i, one in enumerate(PAPER_B.topics)]


@pytest.mark.parametrize(("topics", "vendor"), [(PAPER_B.topics, FAST_DDS), (WEIGHED, ASYNC)])
def test_no_neighbour_of_the_optimum_that_takes_no_more_is_better(topics, vendor):
    found = plan(topics, Medium(), vendor, latency_price_hz=30.0)
    depths, rng = [part.depth for part in found.topics], np.random.default_rng(1)
    best_hz = np.array([part.rate_hz for part in found.topics])
    for size in np.repeat([1e-3, 1e-2, 0.05], 40):
        rates_hz = best_hz * (1 + size * rng.standard_normal(len(topics)))
        # No more than the losses let through.
        rates_hz = np.clip(rates_hz, 1, best_hz.max())
        other = assessed(topics, Medium(), vendor, rates_hz, depths)
        gain = other.freshness - found.freshness - 30.0 * (other.latency_s - found.latency_s)
        assert other.utilisation > found.utilisation or gain <= 1e-5


def ends_of_bounds():
    """Yield a topic's or a link's values, of which one is at an end of what it may be."""
    for kind in (Topic, _Link):
        for name, limits in bounds_of(kind).items():
            for end in (limits.low, limits.high):
                if end in limits and name != "rate_min_hz":
                    yield kind, {name: end}


@VENDORS
@pytest.mark.parametrize(("kind", "values"), [*ends_of_bounds()], ids=repr)
def test_every_legal_value_has_a_plan_within_its_limits_or_an_error_of_ours(kind, values, vendor):
    of_topic, of_link = (values, {}) if kind is Topic else ({}, values)
    asked = [topic(name, rate_min_hz=1e-9, **of_topic) for name in ("/a", "/b")]
    with contextlib.suppress(SfglabError), np.errstate(all="ignore"):
        found = plan(asked, _Link(**of_link).medium, vendor, latency_price_hz=10.0)
        assert found.utilisation <= 0.9 + 1e-5
        for part in found.topics:
            assert part.topic.rate_min_hz <= part.rate_hz <= part.topic.rate_max_hz
            assert 0 < part.latency_s < np.inf
            assert 0 <= part.up_to_date <= 1


@VENDORS
def test_along_the_front_latency_costs_freshness_and_the_default_is_its_best_point_inside(vendor):
    front = pareto_front(replace(PAPER_B, vendor=vendor))
    for point, other in pairwise(front):
        assert other.freshness < point.freshness + 1e-6
        assert other.latency_s < point.latency_s + 1e-8
    shares = [point.up_to_date for point in front]
    chosen = plan(PAPER_B.topics, PAPER_B.medium, vendor)
    assert chosen.up_to_date == max(shares) > max(shares[0], shares[-1])


def test_behind_a_local_cache_as_many_samples_travel_as_in_the_simulation():
    asked = topic(cached=True, change_s=0.1)
    planned = assessed([asked], Medium(), FAST_DDS, [50.0], [10])
    expected_hz = link_of(given([asked], Medium(), FAST_DDS)).sent_hz(np.array([50.0]))
    sent = len(simulated(planned, duration_s=400.0).flows["/a"].fate)
    assert sent / 400 == pytest.approx(expected_hz[0], rel=0.05)


BIG = topic("/big", rate_min_hz=900, size_bytes=1400)


@pytest.mark.parametrize(
    ("topics", "price", "message"),
    [
        ([topic()], 1e300, "solver CLARABEL ended"),
        ([topic("/cam", size_bytes=6_220_800)], 0.0, "'/cam': given '6220800 bytes in 4204 frames"),
        ([topic(), BIG], 0.0, "channel.s time.*/big, /a"),
    ],
)
def test_what_has_no_plan_is_refused(topics, price, message):
    with pytest.raises(SfglabError, match=message):
        plan(topics, Medium(), FAST_DDS, latency_price_hz=price)


# --- The arithmetic and the simulation ---------------------------------------------------------


def test_depth_holds_what_is_published_during_the_repairs():
    """By hand: 2 rounds of 1/50 + 0.01 s and the frames' time are 3.08 samples, so 4, and the lost one."""
    asked = topic(rate_max_hz=50, durability=LATCHED)
    link = link_of(given([asked], Medium(contention=0), FAST_DDS))
    assert depths_for(link, np.array([50.0]), residual_loss=1e-4).tolist() == [5]


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


def up_to_date_of(planned, outcome) -> float:
    """Return the share of time in which readers had the true value, mean over the topics."""
    times_ns, shares = np.arange(1e9, 40e9, 1e6), []
    for part, flow in zip(planned.topics, outcome.flows.values(), strict=True):
        newest = np.searchsorted(flow.received_ns[flow.delivered], times_ns, "right") - 1
        ages_s = (times_ns - flow.published_ns[flow.delivered][newest]) / 1e9
        # A value of age a is still true with probability exp(-a / t).
        shares.append(np.exp(-ages_s / part.topic.change_s).mean())
    return np.mean(shares)


@pytest.mark.parametrize(("depth", "rounds"), [(1, 0), (10, 3), (40, 13)])
def test_the_planned_loss_counts_all_rounds_that_a_history_holds(depth, rounds):
    """Half of the frames are lost, and so three quarters of the rounds, of 1/20 s, 0.1 s and the frames' time.

    A history lasts 1/20 s per sample, and no round waits 0.1 s after the last one.
    """
    asked, medium = topic(durability=LATCHED), Medium(loss=0.5, contention=0)
    planned = assessed([asked], medium, CYCLONE_DDS, [20.0], [depth])
    assert planned.topics[0].loss == pytest.approx(0.5 * (3 / 4) ** rounds)


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


def test_a_large_message_is_lost_with_any_of_its_frames_and_each_receiver_has_its_own():
    asked = [topic(size_bytes=1384), topic(size_bytes=1385), topic(target=HOSTS), topic()]
    link = link_of(given(asked, Medium(), FAST_DDS))
    assert link.loss == pytest.approx([0.01, 1 - 0.99**2, 0.01, 0.01])
    for cost_s in (link.data_s, link.acknack_s):
        assert cost_s[2] == pytest.approx(3 * cost_s[3])
