"""Our own QoS problem: it is convex, its optimum is one, and its arithmetic is that of the simulation."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sfglab.arp.link import at_depths, link_of, repair_delay_s, waits_s
from sfglab.arp.plan import InfeasiblePlanError, Limits, assess, depths_for, plan_as_printed
from sfglab.arp.programme import build_programme, pareto_front, plan
from sfglab.arp.topics import Topic, load_topics
from sfglab.errors import InvalidValueError
from sfglab.qos import Durability, Reliability, incompatibilities
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


def reckoned(planned):
    """Return the link at a plan's depths and rates."""
    bare = link_of([part.topic for part in planned.topics], planned.medium, planned.vendor)
    depths = np.array([part.depth for part in planned.topics])
    return at_depths(bare, depths, planned.rates_hz)


def simulated(planned, *, seed: int = 3, duration_s: float = 40.0):
    """Run a plan in the reliability model, with phases by chance."""
    draw = np.random.default_rng(seed)
    flows = []
    for part in planned.topics:
        asked = part.topic
        phase_s = float(draw.uniform(0, 1 / part.rate_hz))
        changes = {"cached": True, "change_s": asked.change_s} if asked.cached else {}
        for target in asked.targets:
            flow = Flow(
                name=f"{asked.name} to {target}",
                source=asked.source,
                target=target,
                size_bytes=asked.size_bytes,
                rate_hz=part.rate_hz,
                phase_s=phase_s,
                qos=part.qos,
                **changes,
            )
            flows.append(flow)
    given = {"medium": planned.medium, "vendor": planned.vendor, "duration_s": duration_s}
    return run(Scenario(flows=tuple(flows), **given), seed=seed)


def loss_of(outcome) -> float:
    return 1 - float(np.concatenate([flow.delivered for flow in outcome.flows.values()]).mean())


def latency_of(outcome) -> float:
    return float(np.mean([flow.latency_ns.mean() for flow in outcome.flows.values()])) / 1e9


# --- The programme -----------------------------------------------------------------------------


@VENDORS
def test_the_programme_is_convex_and_keeps_to_the_rules_for_parameters(vendor):
    topics = [topic(), topic("/b", reliability=Reliability.BEST_EFFORT)]
    link, bounds_hz = link_of(topics, Medium(), vendor), (np.ones(2), np.full(2, 1000.0))
    assert build_programme(topics, link, bounds_hz, Limits()).problem.is_dcp(dpp=True)


def test_equal_topics_share_the_capacity_equally_where_latency_is_free():
    limits = Limits(utilisation_max=0.4)
    topics = equal_topics(12, rate_max_hz=150)
    found = plan(topics, Medium(), CYCLONE_DDS, latency_price_hz=0.0, limits=limits)
    link = reckoned(found)
    closed_form = 0.4 / float((link.data_s + link.acknack_share * link.acknack_s).sum())
    assert found.rates_hz == pytest.approx(np.full(12, closed_form), rel=1e-4)
    assert found.utilisation == pytest.approx(0.4, rel=1e-5)


def test_the_price_of_airtime_is_what_more_of_it_brings():
    """The dual value against the difference quotient of the optimum itself."""
    topics, step = [*equal_topics(8, change_s=0.1), topic("/slow", change_s=10)], 1e-3
    found = []
    for share in (0.3 - step, 0.3, 0.3 + step):
        limits = Limits(utilisation_max=share)
        found.append(plan(topics, Medium(), ASYNC, latency_price_hz=0.0, limits=limits))
    gain = (found[2].freshness - found[0].freshness) / (2 * step)
    assert found[1].airtime_price == pytest.approx(gain, rel=1e-3)


@VENDORS
def test_no_neighbour_of_the_optimum_is_better(vendor):
    price = 30.0
    found = plan(PAPER_B.topics, Medium(), vendor, latency_price_hz=price)
    rng, link = np.random.default_rng(1), reckoned(found)
    change_s = np.array([part.topic.change_s for part in found.topics])

    def worth(rates_hz):
        # No more than the losses let through, and no more of the medium than they need.
        most_hz = found.rates_hz.max()
        if rates_hz.min() < 1 or rates_hz.max() > most_hz:
            return -np.inf
        if link.utilisation(rates_hz)[0] > found.utilisation:
            return -np.inf
        held_s = repair_delay_s(link, rates_hz, inverse=np.reciprocal)
        latency_s = np.mean(link.way_s + held_s + waits_s(link, rates_hz))
        return np.mean(1 - 1 / (1 + rates_hz * change_s)) - price * latency_s

    best = worth(found.rates_hz * (1 - 1e-6))
    for size in np.repeat([1e-3, 1e-2, 0.05], 40):
        assert worth(found.rates_hz * (1 + size * rng.standard_normal(18))) <= best + 1e-5


@pytest.mark.parametrize("seed", range(25))
def test_every_plan_keeps_to_its_bounds(seed):
    rng = np.random.default_rng(seed)
    values = {"durability": list(Durability)[seed % 2], "cached": seed % 3 == 0}
    topics = [
        topic(f"/t{i}", target=HOSTS[i % 3], change_s=s, size_bytes=300 * i, **values)
        for i, s in enumerate(rng.uniform(0.01, 30, 1 + seed % 6).tolist())
    ]
    medium = Medium(loss=rng.uniform(0, 0.2), shared=seed % 4 > 0)
    vendor = (FAST_DDS, CYCLONE_DDS)[seed // 2 % 2]
    found = plan(topics, medium, vendor, latency_price_hz=rng.uniform(0, 500))
    assert (found.rates_hz >= 1).all()
    assert (found.rates_hz <= 1000).all()
    assert found.utilisation <= 0.9 + 1e-5
    assert all(part.depth >= 2 for part in found.topics)
    assert 0 <= found.up_to_date <= 1


@VENDORS
def test_along_the_front_freshness_is_paid_for_with_latency_and_the_default_is_its_best_point(
    vendor,
):
    front = pareto_front(PAPER_B.topics, PAPER_B.medium, vendor)
    assert (np.diff([point.freshness for point in front]) < 1e-6).all()
    assert (np.diff([point.latency_s for point in front]) < 1e-8).all()
    assert front[0].latency_s > 1.15 * front[-1].latency_s
    chosen = plan(PAPER_B.topics, PAPER_B.medium, vendor)
    assert chosen.up_to_date == max(point.up_to_date for point in front)
    assert front[0].up_to_date < chosen.up_to_date > front[-1].up_to_date, "it lies inside"


def test_slow_values_leave_the_medium_to_others_and_weight_buys_rate():
    topics = [topic("/fast", change_s=0.1), topic("/slow", change_s=10)]
    found = plan(topics, Medium(rate_bps=2e6), CYCLONE_DDS)
    assert found["/fast"].rate_hz > 3 * found["/slow"].rate_hz
    topics = [topic("/plain"), topic("/dear", weight=5)]
    found = plan(topics, Medium(rate_bps=1e6), CYCLONE_DDS, latency_price_hz=1.0)
    assert found["/dear"].rate_hz > 1.5 * found["/plain"].rate_hz
    crowd = [topic(f"/{i}", source="crowd", size_bytes=1400, change_s=0.02) for i in range(30)]
    alone = topic("/alone", target="other", change_s=0.02)
    medium = Medium(shared=False, rate_bps=10e6)
    found = plan([*crowd, alone], medium, CYCLONE_DDS, latency_price_hz=1.0)
    assert found["/alone"].rate_hz > 5 * found["/0"].rate_hz, "a host pays only for what it sends"


def test_behind_a_local_cache_slow_values_are_read_often_and_sent_seldom():
    plain = plan(PAPER_B.topics, PAPER_B.medium, FAST_DDS)
    cached = plan([replace(t, cached=True) for t in PAPER_B.topics], PAPER_B.medium, FAST_DDS)
    assert cached["/robot1/dht11"].rate_hz > 10 * plain["/robot1/dht11"].rate_hz
    assert cached["/robot1/dht11"].deadline_ns is None, "silence is no fault there"
    assert cached.utilisation < plain.utilisation
    assert cached.up_to_date > plain.up_to_date
    outcome = simulated(cached)
    sent = sum(len(flow.fate) for flow in outcome.flows.values()) / 40
    expected = reckoned(cached).sent_hz(cached.rates_hz).sum()
    assert sent == pytest.approx(expected, rel=0.05)


def test_a_topic_with_several_receivers_is_sent_as_often_as_one_for_each_of_them():
    several = equal_topics(4, target=HOSTS, rate_max_hz=400)
    apart = [replace(t, name=f"{t.name}/{h}", target=h) for t in several for h in HOSTS]
    one, other = (plan(t, Medium(), CYCLONE_DDS, latency_price_hz=0.0) for t in (several, apart))
    assert one.rates_hz == pytest.approx(np.full(4, other.rates_hz.mean()), rel=1e-3)


# --- What is refused ---------------------------------------------------------------------------


def test_infeasible_rates_are_named_with_what_they_lack_and_those_at_the_border_still_planned():
    topics = [topic("/small", rate_min_hz=1), topic("/big", rate_min_hz=900, size_bytes=1400)]
    lacking = r"time of the medium.*lacking.*/big, /small"
    with pytest.raises(InfeasiblePlanError, match=lacking) as caught:
        plan(topics, Medium(), FAST_DDS)
    assert caught.value.needed - caught.value.allowed == caught.value.lacking > 0
    link = link_of(equal_topics(4), Medium(), CYCLONE_DDS)
    each_hz = 0.9 / float((link.data_s + link.acknack_share * link.acknack_s).sum())
    border = equal_topics(4, rate_min_hz=0.999 * each_hz)
    assert plan(border, Medium(), CYCLONE_DDS).utilisation == pytest.approx(0.9, rel=2e-3)


@pytest.mark.parametrize(
    ("topics", "prices"), [([], (1.0,)), ([topic()], ()), ([topic()], (-1.0,))]
)
def test_meaningless_input_is_refused(topics, prices):
    with pytest.raises(InvalidValueError, match="at least one of each"):
        pareto_front(topics, Medium(), FAST_DDS, prices_hz=prices)


# --- The arithmetic and the simulation ---------------------------------------------------------


def test_depth_holds_what_is_published_during_the_repairs():
    """By hand: 2 rounds of 1/50 + 0.01 s and the frames' time are 3.08 samples, so 4, and the lost one."""
    link = link_of([topic(rate_max_hz=50, durability=LATCHED)], Medium(contention=0), FAST_DDS)
    assert link.round_s[0] == pytest.approx(0.010 + 2 * 300e-6 + (154 + 138) * 8 / 20e6)
    assert depths_for(link, np.array([50.0]), residual_loss=1e-4).tolist() == [5]


def test_deadline_is_the_historys_length_both_sides_match_and_an_unplanned_topic_is_named():
    found = plan([topic(rate_max_hz=50)], Medium(), FAST_DDS)
    part = found["/a"]
    assert part.deadline_ns == round(part.depth / part.rate_hz * 1e9)
    assert incompatibilities(offered=part.qos, requested=part.qos) == ()
    with pytest.raises(InvalidValueError, match=r"given '/b', allowed: /a"):
        found["/b"]


@pytest.mark.parametrize("rate_max_hz", [100, 500])
def test_with_fast_dds_ours_is_sooner_than_the_published_optimum_and_loses_as_little_as_planned(
    rate_max_hz,
):
    """The published depths lose nothing where the medium is not overloaded: they wait for seconds instead."""
    given = PAPER_B.limited_to(rate_max_hz)
    ours, published = plan(given.topics, given.medium, FAST_DDS), plan_as_printed(given)
    one, other = (simulated(planned, duration_s=12.0) for planned in (ours, published))
    p95 = []
    for outcome in (one, other):
        latencies_ns = np.concatenate([flow.latency_ns for flow in outcome.flows.values()])
        p95.append(np.percentile(latencies_ns, 95))
    assert 20 * p95[0] <= p95[1]
    assert loss_of(one) <= max(loss_of(other), 4e-4)
    assert max(part.loss for part in ours.topics) < 4e-4
    assert published.latency_s > 0.25, "repairs wait for the periodic heartbeat"
    assert 0.4 < latency_of(other) / published.latency_s < 1


@VENDORS
@pytest.mark.parametrize("price", [10.0, 300.0])
def test_expected_latency_airtime_and_freshness_are_as_simulated(vendor, price):
    """Queues are reckoned for random arrivals, so latency lies above, up to 80 % of the air by less than twofold."""
    planned = plan(PAPER_B.topics, PAPER_B.medium, vendor, latency_price_hz=price)
    outcome = simulated(planned)
    assert planned.utilisation < 0.8
    assert 0.5 < latency_of(outcome) / planned.latency_s < 1.05
    air = outcome.counts["airtime_ns"] / 40e9
    assert 0.9 < air * (1 + reckoned(planned).contention) / planned.utilisation < 1.2
    shares = []
    for part in planned.topics:
        name = f"{part.topic.name} to {part.topic.target}"
        flow, change_s = outcome.flows[name], part.topic.change_s
        received, published = flow.received_ns / 1e9, flow.published_ns / 1e9
        received, published = received[flow.delivered], published[flow.delivered]
        until = np.append(received[1:], 40.0)
        # A value of age a is still true with probability exp(-a / t).
        true = np.exp((published - received) / change_s) - np.exp((published - until) / change_s)
        shares.append(change_s * true.sum() / 40)
    assert np.mean(shares) == pytest.approx(planned.up_to_date, abs=0.015)


def test_the_planned_depth_repairs_and_what_no_depth_can_keep_is_in_the_planned_loss():
    """10 % loss: a TRANSIENT_LOCAL history keeps all, a VOLATILE one of Fast DDS as much as planned."""
    medium = Medium(loss=0.1)
    planned = plan(equal_topics(4, rate_max_hz=50, durability=LATCHED), medium, FAST_DDS)
    shallow = replace(planned, topics=tuple(replace(part, depth=1) for part in planned.topics))
    assert loss_of(simulated(planned)) < 2e-3
    assert loss_of(simulated(shallow)) > 0.05
    volatile = plan(equal_topics(4, rate_max_hz=50), medium, FAST_DDS)
    assert volatile.topics[0].loss == pytest.approx(0.1 * (1 - 0.9**3), rel=0.01)
    assert 0 < loss_of(simulated(volatile)) < volatile.topics[0].loss


@pytest.mark.parametrize(
    ("vendor", "depth", "values"),
    [
        (FAST_DDS, 2, {}),
        (FAST_DDS, 4, {}),
        (FAST_DDS, 30, {"durability": LATCHED}),
        (CYCLONE_DDS, 30, {}),
    ],
)
@pytest.mark.parametrize("rate_hz", [5, 20, 80])
def test_of_one_topic_delays_losses_and_acknowledgements_are_as_simulated(
    vendor, depth, values, rate_hz
):
    """Heartbeats ride with one sample in two or four, or with each, so that depth delays nothing."""
    medium, rates_hz = Medium(contention=0), np.array([float(rate_hz)])
    given = {"rates_hz": rates_hz, "depths": np.array([depth]), "method": "by hand"}
    planned = assess([topic(**values)], medium, vendor, **given)
    link, samples = reckoned(planned), 40_000
    runs = [simulated(planned, seed=seed, duration_s=samples / rate_hz) for seed in range(8)]
    held_s = float(repair_delay_s(link, rates_hz, inverse=np.reciprocal)[0])
    acknacks = np.mean([outcome.counts["acknack"] for outcome in runs]) / samples
    delay_s = np.mean([latency_of(outcome) for outcome in runs]) - link.way_s[0]
    assert held_s == pytest.approx(delay_s, rel=0.25)
    assert planned.topics[0].loss > np.mean([loss_of(outcome) for outcome in runs]) - 5e-5
    assert link.acknack_share[0] == pytest.approx(acknacks, abs=0.05)


def test_the_published_plan_counts_topics_of_agents_and_is_rounded_down():
    published = plan_as_printed(PAPER_B.limited_to(500))
    assert PAPER_B.topics_of_agents() == (7, 5, 6)
    assert published.rates_hz == pytest.approx(np.full(18, 500 / 6 - 1), rel=1e-6)
    assert {part.depth for part in published.topics} == {822}
    overloaded = plan_as_printed(PAPER_B.limited_to(1000))
    assert overloaded.utilisation > 1
    assert overloaded.latency_s == float("inf")
    assert overloaded.up_to_date == 0
    limited = replace(PAPER_B, topics=(topic(rate_min_hz=20),)).limited_to(10).topics[0]
    assert (limited.rate_min_hz, limited.rate_max_hz) == (10, 10)


@pytest.mark.parametrize(("size_bytes", "frames"), [(24, 1), (1384, 1), (1385, 2), (100_000, 68)])
def test_a_large_message_takes_several_frames_and_is_lost_with_any_of_them(size_bytes, frames):
    medium = Medium(loss=0.01, contention=0.0)
    link = link_of([topic(size_bytes=size_bytes)], medium, FAST_DDS)
    assert link.loss[0] == pytest.approx(1 - 0.99**frames)
    frames_s = frames * (medium.overhead_s + 34 * 8 / medium.rate_bps)
    bits = (size_bytes + 100) * 8
    assert link.way_s[0] == pytest.approx(frames_s + bits / medium.rate_bps, rel=0.1)
