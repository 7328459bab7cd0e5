"""The engine as plain Python with every index checked: it stays in its arrays, as compiled code does."""

import contextlib
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numba.core.registry import CPUDispatcher

from sfglab.qos import Durability, History, QoSProfile, Reliability
from sfglab.rtps import (
    PRESETS,
    Drop,
    Fate,
    Flow,
    Medium,
    Scenario,
    engine,
    medium,
    reader,
    run,
    world,
    writer,
)
from sfglab.rtps.channel import QUEUE_RULES

MODULES = (engine, medium, reader, world, writer)


class Checked(np.ndarray):
    """An array that refuses indices before its start, as others do beyond their end; compiled code neither."""

    def __getitem__(self, index):
        self._check(index)
        return super().__getitem__(index)

    def __setitem__(self, index, value):
        self._check(index)
        super().__setitem__(index, value)

    def _check(self, index):
        for i in index if isinstance(index, tuple) else (index,):
            if isinstance(i, int | np.integer) and i < 0:
                raise IndexError(f"index {i} before the start")


@contextlib.contextmanager
def interpreted():
    """Let the compiled functions of the engine be the Python functions that they were compiled from."""
    with pytest.MonkeyPatch.context() as patch, np.errstate(over="ignore"):
        for module in MODULES:
            for name, value in list(vars(module).items()):
                if isinstance(value, CPUDispatcher):
                    patch.setattr(module, name, value.py_func)
        patch.setattr(world, "World", checked_world)
        yield


def checked_world(*parts):
    arrays = {name: array for part in parts for name, array in part._asdict().items()}
    return SimpleNamespace(**{n: a.view(Checked) if a.ndim else a[()] for n, a in arrays.items()})


qos = st.builds(
    QoSProfile,
    history=st.sampled_from([History.KEEP_LAST, History.KEEP_LAST, History.KEEP_ALL]),
    depth=st.sampled_from([1, 2, 5, 10, 100, 1000]),
    reliability=st.sampled_from(
        [Reliability.RELIABLE, Reliability.RELIABLE, Reliability.BEST_EFFORT]
    ),
    durability=st.sampled_from([Durability.VOLATILE, Durability.TRANSIENT_LOCAL]),
)
HOSTS = ("robot1", "robot2", "station")


@st.composite
def flow(draw, name, then):
    source, target = draw(st.permutations(HOSTS))[:2]
    return Flow(
        name=name,
        source=source,
        target=target,
        size_bytes=draw(st.sampled_from([0, 24, 1001])),
        rate_hz=draw(st.sampled_from([0.0, 33.0, 200.0, 700.0])),
        phase_s=draw(st.sampled_from([0.0, 0.013])),
        qos=draw(qos),
        reader_depth=draw(st.sampled_from([None, 0, 1, 2, 3, 10, 1000])),
        executor=draw(st.sampled_from([None, "shared"])),
        service_s=draw(st.sampled_from([0.0, 0.0002, 0.005])),
        compare_s=draw(st.sampled_from([None, 0.0, 0.0001])),
        change_s=draw(st.sampled_from([0.0, 0.002, 0.02])),
        cached=draw(st.booleans()),
        max_silence_s=draw(st.sampled_from([None, 0.01])),
        then=then,
    )


@st.composite
def scenarios(draw):
    names, shared = "abcd"[: draw(st.integers(1, 4))], draw(st.booleans())
    # A chain goes to a later flow: a ring would publish for ever.
    chains = [draw(st.sampled_from([None, *names[i + 1 :]])) for i in range(len(names))]
    return Scenario(
        flows=tuple(draw(flow(name, then)) for name, then in zip(names, chains, strict=True)),
        medium=Medium(
            rate_bps=draw(st.sampled_from([3e5, 2e6, 20e6])),
            loss=draw(st.sampled_from([0.0, 0.05, 0.3, 0.7])),
            shared=shared,
            overhead_s=draw(st.sampled_from([0.0, 3e-4])),
            latency_s=draw(st.sampled_from([0.0, 0.004])),
            queue_frames=draw(st.sampled_from([1, 3, 500])),
            queue_rule=draw(st.sampled_from(QUEUE_RULES)),
            access_point=shared and draw(st.booleans()),
            random_turns=draw(st.booleans()),
            burst_frames=draw(st.sampled_from([0.0, 4.0])),
            stall_every_s=0.05,
            stall_s=draw(st.sampled_from([0.0, 0.02])),
        ),
        vendor=draw(st.sampled_from(list(PRESETS.values()))),
        duration_s=draw(st.sampled_from([0.05, 0.3])),
        drain_s=draw(st.sampled_from([0.0, 0.2, 7.0])),
        unacked_most=draw(st.sampled_from([1, 7, 5000])),
    )


DEEP = QoSProfile(depth=1000)
FLOW = Flow(name="a", source="robot1", target="station", rate_hz=1000, reader_depth=10, qos=DEEP)
DEEP_WRITER = Scenario(flows=(FLOW,), medium=Medium(loss=0.1), duration_s=1.5)


@settings(max_examples=80, deadline=None)
@given(scenarios(), st.integers(0, 100))
@example(DEEP_WRITER, 0)
def test_no_run_leaves_its_arrays_and_compiled_code_does_the_same(scenario, seed):
    with interpreted():
        plain = run(scenario, seed=seed)
    compiled = run(scenario, seed=seed)
    assert plain.counts == compiled.counts
    for name, flow in compiled.flows.items():
        for field in ("published_ns", "received_ns", "value", "fate", "dropped"):
            assert np.array_equal(getattr(plain.flows[name], field), getattr(flow, field)), (
                name,
                field,
            )


@settings(max_examples=120, deadline=None)
@given(scenarios(), st.integers(0, 5))
def test_samples_come_in_order_after_their_publication_and_every_loss_has_a_place(scenario, seed):
    done = run(replace(scenario, duration_s=3.0), seed=seed)
    for told in scenario.flows:
        flow = done.flows[told.name]
        in_order = np.diff(flow.received_ns[flow.delivered]) >= 0
        assert in_order.all(), "one executor, in order of sequence numbers"
        assert (flow.latency_ns >= 0).all()
        assert ((flow.received_ns > 0) == flow.delivered).all()
        assert (flow.fate != Fate.NEVER_SENT).all()
        if (
            not 0 < scenario.vendor.reorder_most < told.qos.depth
        ):  # else a reader drops what waits behind a gap
            assert (flow.dropped[flow.fate == Fate.OVERWRITTEN] != Drop.NOT).all()


def test_a_shallow_reader_of_a_deep_writer_loses_in_its_own_history_what_waits_behind_a_gap():
    assert (run(DEEP_WRITER, seed=0).flows["a"].fate == Fate.LATE).sum() > 500


@pytest.mark.parametrize("rate_hz", [4e8, 7e8, 1e9])
def test_a_period_of_few_nanoseconds_leaves_room_for_its_samples(rate_hz):
    flow = Flow(name="a", source="a", target="b", rate_hz=rate_hz)
    done = run(Scenario(flows=(flow,), duration_s=1e-6), seed=0).flows["a"]
    assert len(done.fate) == -(-1000 // round(1e9 / rate_hz))
