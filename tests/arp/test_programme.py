"""The QoS programme: it is convex, its optimum is one, and its arithmetic is that of the simulation."""

import contextlib
from dataclasses import replace
from functools import partial
from pathlib import Path
from random import Random

import numpy as np
import pytest
import yaml

from sfglab.arp.link import link_of
from sfglab.arp.plan import InfeasiblePlanError, assess, depths_for, plan_as_printed
from sfglab.arp.programme import pareto_front, plan, plan_file
from sfglab.arp.topics import Limits, Topic, TopicFile, _Link, load_topics, read_topics
from sfglab.documents import Document
from sfglab.errors import InvalidValueError, SfglabError
from sfglab.fields import Bounds, bounds_of
from sfglab.qos import Durability, Reliability
from sfglab.rtps import CYCLONE_DDS, FAST_DDS, PRESETS, Flow, Medium, Scenario, run

PAPER_B = load_topics(Path(__file__).parents[2] / "data" / "qos" / "paper_b.yaml")
ASYNC = PRESETS["fast_dds_async"]
VENDORS = pytest.mark.parametrize("vendor", [FAST_DDS, CYCLONE_DDS, ASYNC], ids=lambda v: v.name)
LATCHED = Durability.TRANSIENT_LOCAL
HOSTS = ("station", "robot2", "robot3")


def topic(name: str = "/a", **values) -> Topic:
    usual = {"source": "robot", "target": "station", "size_bytes": 24}
    return Topic(name=name, **usual | values)


def equal_topics(count: int, **values) -> list[Topic]:
    return [topic(f"/t{i}", **values) for i in range(count)]


def simulated(planned, *, seed: int = 3, duration_s: float = 40.0):
    """Run a plan, of topics with one receiver each, in the reliability model, with random phases."""
    draw = np.random.default_rng(seed)
    flows = []
    for part in planned.topics:
        flow = Flow(
            name=part.topic.name,
            source=part.topic.source,
            target=part.topic.target,
            size_bytes=part.topic.size_bytes,
            rate_hz=part.rate_hz,
            phase_s=draw.uniform(0, 1 / part.rate_hz),
            qos=part.qos,
            cached=part.topic.cached,
            change_s=part.topic.change_s,
        )
        flows.append(flow)
    given = {"medium": planned.medium, "vendor": planned.vendor, "duration_s": duration_s}
    return run(Scenario(flows=tuple(flows), **given), seed=seed)


def assessed(topics, medium, vendor, rates_hz, depths):
    rates_hz, depths = np.asarray(rates_hz), np.asarray(depths)
    return assess(topics, medium, vendor, rates_hz=rates_hz, depths=depths, method="by hand")


def loss_of(outcome) -> float:
    return 1 - np.concatenate([flow.delivered for flow in outcome.flows.values()]).mean()


def latency_of(outcome) -> float:
    return np.mean([flow.latency_ns.mean() for flow in outcome.flows.values()]) / 1e9


# --- The programme -----------------------------------------------------------------------------


@pytest.mark.parametrize("target", ["station", HOSTS], ids=["one", "three"])
def test_equal_topics_share_the_capacity_equally_up_to_the_border_of_what_is_feasible(target):
    """A topic with several receivers costs as much as one topic for each of them."""
    medium, topics = Medium(contention=0), equal_topics(4, target=target)
    link = link_of(equal_topics(4 * len(topics[0].targets)), medium, CYCLONE_DDS)
    each_hz = 0.9 / (link.data_s + link.acknack_share * link.acknack_s).sum()
    for lowest_hz in (1.0, 0.999 * each_hz):
        asked = [replace(one, rate_min_hz=lowest_hz) for one in topics]
        found = plan(asked, medium, CYCLONE_DDS, latency_price_hz=0.0)
        assert found.rates_hz == pytest.approx(np.full(4, each_hz), rel=1e-3)
    asked = [replace(one, rate_min_hz=1.1 * each_hz) for one in topics]
    with pytest.raises(InfeasiblePlanError) as caught:
        plan(asked, medium, CYCLONE_DDS)
    assert caught.value.lacking == pytest.approx(0.09)


def test_the_price_of_airtime_is_the_difference_quotient_of_the_optimum():
    topics, step = [*equal_topics(8, change_s=0.1), topic("/slow", change_s=10)], 1e-3
    found = []
    for share in (0.3 - step, 0.3, 0.3 + step):
        limits = Limits(utilisation_max=share)
        found.append(plan(topics, Medium(), ASYNC, latency_price_hz=0.0, limits=limits))
    gain = (found[2].freshness - found[0].freshness) / (2 * step)
    assert found[1].airtime_price == pytest.approx(gain, rel=1e-3)


@VENDORS
def test_no_neighbour_of_the_optimum_that_takes_no_more_is_better(vendor):
    price_hz = 30.0
    found = plan(PAPER_B.topics, Medium(), vendor, latency_price_hz=price_hz)
    depths, rng = [part.depth for part in found.topics], np.random.default_rng(1)
    best = found.freshness - price_hz * found.latency_s
    for size in np.repeat([1e-3, 1e-2, 0.05], 40):
        rates_hz = found.rates_hz * (1 + size * rng.standard_normal(18))
        # No more than the losses let through.
        rates_hz = np.clip(rates_hz, 1, found.rates_hz.max())
        other = assessed(PAPER_B.topics, Medium(), vendor, rates_hz, depths)
        if other.utilisation <= found.utilisation:
            assert other.freshness - price_hz * other.latency_s <= best + 1e-5


@pytest.mark.parametrize("seed", range(25))
def test_every_plan_keeps_to_its_bounds(seed):
    draw = Random(seed)
    topics = []
    for host in HOSTS[: 1 + seed % 3]:
        values = {"change_s": draw.uniform(0.01, 30), "size_bytes": draw.randrange(2000)}
        values["reliability"] = draw.choice(list(Reliability))
        topics.append(topic(f"/{host}", target=host, cached=seed % 2 > 0, **values))
    medium = Medium(loss=draw.uniform(0, 0.2), shared=seed % 4 > 0)
    vendor = draw.choice([FAST_DDS, CYCLONE_DDS])
    found = plan(topics, medium, vendor, latency_price_hz=draw.uniform(0, 500))
    assert 1 <= found.rates_hz.min() <= found.rates_hz.max() <= 1000
    assert found.utilisation <= 0.9 + 1e-5
    assert min(part.depth for part in found.topics) >= 2
    assert 0 <= found.up_to_date <= 1


def drawn(draw, name, limits, log=(-9, 9)):
    """Return a legal value of a bounded field, or none, for its default."""
    low, high = max(limits.low, 10.0 ** log[0]), min(limits.high, 10.0 ** log[1])
    value = draw.choice([low, high, *np.geomspace(low, high, 9)[1:-1].tolist()])
    value = int(value) if name in ("size_bytes", "queue_frames") else value
    return {name: value} if value in limits and draw.random() < 0.5 else {}


def drawn_text(draw) -> str:
    """Return a file of topics that `load_topics` reads, with values anywhere in their bounds."""
    link, timing, topics = {}, {}, {}
    for name, limits in bounds_of(_Link).items():
        link |= drawn(draw, name, limits)
    for name in ("heartbeat_ms", "nack_delay_ms", "ack_delay_ms"):
        timing |= drawn(draw, name, Bounds(1e-3, 1e6))
    for number in range(draw.randint(1, 3)):
        values = {"from": draw.choice("ab"), "to": draw.choice([["c"], ["c", "d"]])}
        values |= {"size_bytes": draw.choice([0, 24, 5000]), "rate_min_hz": 1e-9}
        for name, limits in bounds_of(Topic).items():
            values |= {} if name == "rate_min_hz" else drawn(draw, name, limits)
        values["reliability"] = draw.choice([member.value for member in Reliability])
        values["durability"] = draw.choice([member.value for member in Durability])
        topics[f"/t{number}"] = values | {"cached": draw.random() < 0.3}
    given = {"topics": topics, "link": link, "timing": timing, "vendor": draw.choice([*PRESETS])}
    return yaml.safe_dump(given)


@pytest.mark.parametrize("seed", range(60))
def test_every_legal_file_has_a_plan_or_an_error_of_ours(seed):
    draw = Random(seed)
    given = read_topics(Document(drawn_text(draw), "t.yaml"))
    for method in (partial(plan_file, latency_price_hz=10 ** draw.uniform(-1, 3)), plan_as_printed):
        with contextlib.suppress(SfglabError), np.errstate(all="ignore"):
            for part in method(given).topics:
                assert np.isfinite(part.rate_hz)
                assert part.latency_s > 0
                assert 0 <= part.up_to_date <= 1
                assert 0 <= part.loss <= 0.99
                assert part.deadline_ns is None or part.deadline_ns > 0


@VENDORS
def test_along_the_front_latency_costs_freshness_and_the_default_is_its_best_point_inside(vendor):
    front = pareto_front(PAPER_B.topics, PAPER_B.medium, vendor)
    values = [(point.freshness, point.latency_s) for point in front]
    assert (np.diff(values, axis=0) < (1e-6, 1e-8)).all()
    assert front[0].latency_s > 1.15 * front[-1].latency_s
    shares = [point.up_to_date for point in front]
    chosen = plan(PAPER_B.topics, PAPER_B.medium, vendor)
    assert chosen.up_to_date == max(shares) > max(shares[0], shares[-1])


FAST, SLOW = topic("/fast", change_s=0.1), topic("/slow", change_s=10)
CROWD = equal_topics(30, source="crowd", size_bytes=1400, change_s=0.02)
ALONE = topic("/alone", target="other", change_s=0.02)


@pytest.mark.parametrize(
    ("topics", "medium", "ratio"),
    [
        ([FAST, SLOW], Medium(rate_bps=2e6), 3),
        ([replace(FAST, weight=5), FAST], Medium(rate_bps=1e6), 1.5),
        ([ALONE, *CROWD], Medium(shared=False, rate_bps=10e6), 5),
    ],
    ids=["changes", "weight", "a host of its own"],
)
def test_changes_weight_and_a_host_with_time_to_spare_give_a_topic_rate(topics, medium, ratio):
    rates_hz = plan(topics, medium, CYCLONE_DDS, latency_price_hz=1.0).rates_hz
    assert rates_hz[0] > ratio * rates_hz[-1]


def test_behind_a_local_cache_slow_values_are_read_often_and_sent_seldom():
    topics = [replace(asked, cached=True) for asked in PAPER_B.topics]
    plain, cached = (plan(each, PAPER_B.medium, FAST_DDS) for each in (PAPER_B.topics, topics))
    assert cached["/robot1/dht11"].rate_hz > 10 * plain["/robot1/dht11"].rate_hz
    assert cached.up_to_date > plain.up_to_date
    sent = sum(len(flow.fate) for flow in simulated(cached).flows.values())
    change_hz = 1 / np.array([asked.change_s for asked in topics])
    found_new = 1 - np.exp(-change_hz / cached.rates_hz)
    assert sent / 40 == pytest.approx(cached.rates_hz @ found_new, rel=0.05)


BIG = topic("/big", rate_min_hz=900, size_bytes=1400)


@pytest.mark.parametrize(
    ("topics", "prices", "message"),
    [
        ([], (1.0,), "at least one of each"),
        ([topic()], (), "at least one of each"),
        ([topic()], (-1.0,), "at least one of each"),
        ([topic()], (np.inf,), "at least one of each, prices finite"),
        ([topic()], (1e300,), "solver CLARABEL ended"),
        (
            [topic("/cam", size_bytes=6_220_800)],
            (0.0,),
            "'/cam': given '6220800 bytes in 4204 frames",
        ),
        ([topic(), BIG], (0.0,), "time of the medium.*lacking.*/big, /a"),
    ],
)
def test_meaningless_input_and_too_high_rates_are_refused(topics, prices, message):
    with pytest.raises(SfglabError, match=message):
        pareto_front(topics, Medium(), FAST_DDS, prices_hz=prices)


# --- The arithmetic and the simulation ---------------------------------------------------------


def test_depth_holds_what_is_published_during_the_repairs_and_deadline_is_its_length():
    """By hand: 2 rounds of 1/50 + 0.01 s and the frames' time are 3.08 samples, so 4, and the lost one."""
    asked = topic(rate_max_hz=50, durability=LATCHED)
    link = link_of([asked], Medium(contention=0), FAST_DDS)
    assert depths_for(link, np.array([50.0]), residual_loss=1e-4).tolist() == [5]
    planned = assessed([asked], Medium(), FAST_DDS, [50.0], [5])
    assert planned["/a"].qos.deadline_ns == 100_000_000
    with pytest.raises(InvalidValueError, match=r"given '/b', allowed: /a"):
        planned["/b"]


@pytest.mark.parametrize("rate_max_hz", [100, 500])
def test_with_fast_dds_ours_is_sooner_than_the_published_optimum_and_loses_as_little(rate_max_hz):
    """The published depths lose nothing where the medium is not overloaded: they wait for seconds instead."""
    given = PAPER_B.limited_to(rate_max_hz)
    ours, published = plan(given.topics, given.medium, FAST_DDS), plan_as_printed(given)
    one, other = simulated(ours, duration_s=12.0), simulated(published, duration_s=12.0)
    assert 20 * latency_of(one) <= latency_of(other)
    assert loss_of(one) <= max(loss_of(other), 4e-4)
    assert max(part.loss for part in ours.topics) < 4e-4
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
        published_s, received_s = flow.published_ns / 1e9, flow.received_ns / 1e9
        received_s = received_s[flow.delivered]
        ends_s = np.stack((received_s, np.append(received_s[1:], duration_s)))
        # A value of age a is still true with probability exp(-a / t).
        true = np.exp((published_s[flow.delivered] - ends_s) / part.topic.change_s)
        shares.append(part.topic.change_s * (true[0] - true[1]).sum() / duration_s)
    return np.mean(shares)


def test_readers_are_less_up_to_date_by_what_a_shallow_history_loses():
    """Half of the samples of a history of one are lost for good, although the topic is RELIABLE."""
    asked = topic(change_s=0.1, durability=LATCHED)
    planned = assessed([asked], Medium(loss=0.5, contention=0), CYCLONE_DDS, [20.0], [1])
    assert planned.topics[0].loss > 0.2
    per_change = 20.0 * (1 - planned.topics[0].loss) * asked.change_s
    sent_true = per_change * (1 - np.exp(-1 / per_change))
    late = np.exp(-planned.latency_s / asked.change_s)
    assert planned.up_to_date == pytest.approx(sent_true * late)


def test_the_planned_loss_counts_all_rounds_of_retransmissions_that_a_history_holds():
    """Half of the frames are lost, and so three quarters of the rounds: 0.5 (3 / 4)^k after k rounds."""
    asked, medium = topic(rate_max_hz=20, durability=LATCHED), Medium(loss=0.5, contention=0)
    losses = []
    for depth in (2, 10, 20, 40):
        planned = assessed([asked], medium, CYCLONE_DDS, [20.0], [depth])
        losses.append(planned.topics[0].loss)
        rounds = np.log(2 * losses[-1]) / np.log(3 / 4)
        assert rounds == pytest.approx(round(rounds), abs=1e-6)
    assert (np.diff(losses) < 0).all()


def test_the_papers_depth_is_a_whole_number_where_the_problem_has_one():
    """T_a = 2, Rmax = 1000: R = 1000 / 2 - 1 and D = 5000 R / 1000 - 1 = 2494."""
    given = TopicFile(topics=tuple(equal_topics(2)), agents=("robot",))
    (first, _) = plan_as_printed(given).topics
    assert (first.rate_hz, first.depth) == (499, 2494)


def test_a_deadline_is_two_periods_at_least():
    planned = assessed([topic()], Medium(), FAST_DDS, [10.0], [1])
    assert planned.topics[0].deadline_ns == planned.topics[0].qos.deadline_ns == 200_000_000


def test_the_planned_depth_repairs_and_what_no_depth_can_keep_is_in_the_planned_loss():
    """10 % loss: a TRANSIENT_LOCAL history keeps all, a VOLATILE one of Fast DDS as much as planned."""
    asked = equal_topics(4, rate_max_hz=50, durability=LATCHED)
    planned = plan(asked, Medium(loss=0.1), FAST_DDS)
    shallow = replace(planned, topics=tuple(replace(part, depth=1) for part in planned.topics))
    assert loss_of(simulated(planned)) < 2e-3
    assert loss_of(simulated(shallow)) > 0.05
    volatile = plan(equal_topics(4, rate_max_hz=50), Medium(loss=0.1), FAST_DDS)
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
    asked, samples = topic(durability=durability), 40_000
    planned = assessed([asked], Medium(contention=0), vendor, [rate_hz], [depth])
    measured = []
    for seed in range(8):
        outcome = simulated(planned, seed=seed, duration_s=samples / rate_hz)
        measured.append((latency_of(outcome), loss_of(outcome)))
    latency_s, loss = np.mean(measured, axis=0)
    way_s = link_of([asked], planned.medium, vendor).way_s[0]
    assert planned.latency_s - way_s == pytest.approx(latency_s - way_s, rel=0.25)
    assert planned.topics[0].loss > loss - 5e-5


def test_a_limit_lowers_the_least_rate_with_the_largest():
    limited = replace(PAPER_B, topics=(BIG,)).limited_to(10).topics[0]
    assert (limited.rate_min_hz, limited.rate_max_hz) == (10, 10)


@pytest.mark.parametrize(("size_bytes", "frames"), [(24, 1), (1384, 1), (1385, 2), (100_000, 68)])
def test_a_large_message_takes_several_frames_and_is_lost_with_any_of_them(size_bytes, frames):
    medium = Medium(loss=0.01, rate_bps=1e12)
    link = link_of([topic(size_bytes=size_bytes)], medium, FAST_DDS)
    assert link.loss[0] == pytest.approx(1 - 0.99**frames)
    assert link.way_s[0] == pytest.approx(frames * medium.overhead_s, rel=0.01)
