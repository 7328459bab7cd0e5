"""Scenarios drawn from everything that a scenario can say: arrays, invariants, and outcomes that do not change."""

import contextlib
import hashlib
import json
from random import Random
from types import SimpleNamespace

import numpy as np
import pytest
from numba.core.registry import CPUDispatcher

from sfglab.qos import Durability, QoSProfile, Reliability
from sfglab.rtps import (
    PRESETS,
    Flow,
    Medium,
    Scenario,
    engine,
    medium,
    model,
    reader,
    run,
    trace,
    world,
    writer,
)

FIELDS = ("published_ns", "received_ns", "value", "fate")
QOS = {
    "depth": [1, 2, 5, 10, 100, 1000],
    "reliability": [Reliability.RELIABLE, Reliability.RELIABLE, Reliability.BEST_EFFORT],
    "durability": list(Durability),
}
FLOWS = {
    "size_bytes": [0, 24, 1001],
    "rate_hz": [0.0, 33.0, 200.0, 700.0],
    "phase_s": [0.0, 0.013],
    "reader_depth": [None, 1, 2, 3, 10, 1000],
    "executor": [None, "shared"],
    "service_s": [0.0, 0.0002, 0.005],
    "compare_s": [None, 0.0, 0.0001],
    "change_s": [0.0, 0.002, 0.02],
    "cached": [True, False],
}
MEDIA = {
    "rate_bps": [3e5, 2e6, 20e6],
    "loss": [0.0, 0.05, 0.3, 0.7],
    "overhead_s": [0.0, 3e-4],
    "latency_s": [0.0, 0.004],
    "queue_frames": [1, 3, 500],
    "queue_rule": ["tail", "head", "block"],
    "random_turns": [True, False],
    "burst_frames": [0.0, 4.0],
    "stall_s": [0.0, 0.02],
}
RUNS = {"duration_s": [0.05, 0.3], "drain_s": [0.0, 0.2, 7.0]}
HOSTS = ("robot1", "robot2", "station")
# Whether hosts share the medium, and whether an access point relays.
SHARING = [(False, False), (True, False), (True, True)]


def picked(draw: Random, table):
    return {name: draw.choice(values) for name, values in table.items()}


def drawn(number: int, preset: str | None = None) -> Scenario:
    draw = Random(number)
    names = "abcd"[: draw.randint(1, 4)]
    flows = []
    for i, name in enumerate(names):
        source, target = draw.sample(HOSTS, 2)
        then = draw.choice([None, *names[i + 1 :]])  # a ring would publish without end
        values = picked(draw, FLOWS) | {"qos": QoSProfile(**picked(draw, QOS))}
        flows.append(Flow(name=name, source=source, target=target, then=then, **values))
    shared, relayed = draw.choice(SHARING)
    air = Medium(shared=shared, access_point=relayed, stall_every_s=0.05, **picked(draw, MEDIA))
    vendor = PRESETS[preset or draw.choice(list(PRESETS))]
    with pytest.MonkeyPatch.context() as patch:
        # Some flows that others publish have changes of their own, which is refused by now.
        patch.setattr(model, "check_chains", lambda _: None)
        return Scenario(flows=tuple(flows), medium=air, vendor=vendor, **picked(draw, RUNS))


def parts_of(outcome) -> list[bytes]:
    """Return everything that a run says, as bytes."""
    parts = [json.dumps(outcome.counts).encode()]
    for flow in outcome.flows.values():
        parts.extend(getattr(flow, field).tobytes() for field in FIELDS)
    return parts


# --- Arrays: the engine as plain Python with every index checked stays in them -----------------


class Checked(np.ndarray):
    """An array that refuses indices before its start, as others do beyond their end; compiled code neither."""

    def __getitem__(self, index):
        check(index)
        return super().__getitem__(index)

    def __setitem__(self, index, value):
        check(index)
        super().__setitem__(index, value)


def check(index):
    for i in index if isinstance(index, tuple) else (index,):
        assert not isinstance(i, int | np.integer) or i >= 0, "before the start"


@contextlib.contextmanager
def interpreted():
    """Let the compiled functions of the engine be the Python functions that they were compiled from."""
    with pytest.MonkeyPatch.context() as patch, np.errstate(over="ignore"):
        for module in (engine, medium, reader, world, writer):
            for name, value in list(vars(module).items()):
                if isinstance(value, CPUDispatcher):
                    patch.setattr(module, name, value.py_func)
        patch.setattr(world, "World", checked_world)
        yield


def checked_world(*parts):
    arrays = {name: array for part in parts for name, array in part._asdict().items()}
    return SimpleNamespace(**{n: a.view(Checked) if a.ndim else a[()] for n, a in arrays.items()})


FLOW = Flow(
    name="a",
    source="robot1",
    target="station",
    rate_hz=1000,
    reader_depth=10,
    qos=QoSProfile(depth=1000),
)
DEEP_WRITER = Scenario(flows=(FLOW,), medium=Medium(loss=0.1), duration_s=1.5)


@pytest.mark.parametrize("scenario", [DEEP_WRITER, *map(drawn, range(80))])
def test_no_run_leaves_its_arrays_and_compiled_code_does_the_same_in_order(scenario):
    with interpreted():
        plain = run(scenario, seed=3)
    done = run(scenario, seed=3)
    assert parts_of(plain) == parts_of(done)
    for flow in done.flows.values():
        assert (np.diff(flow.received_ns[flow.delivered]) >= 0).all(), "one executor, in order"
        assert (flow.latency_ns >= 0).all()
        assert ((flow.received_ns > 0) == flow.delivered).all()


# --- Outcomes: the committed logs were made by this model, so it must not change ----------------


def digest(preset: str) -> str:
    """Return a digest of the outcomes of 60 scenarios and of every frame of 15 of them."""
    text = hashlib.sha256()
    for number in range(60):
        scenario = drawn(number, preset)
        done, frames = trace(scenario, seed=7) if number % 4 == 0 else (run(scenario, seed=7), ())
        counts, *values = parts_of(done)
        text.update(b"".join((counts, repr(frames).encode(), *values)))
    return text.hexdigest()[:16]


DIGESTS = {
    "fast_dds": "3ac5e5cacff8cc09",
    "cyclone_dds": "f23e29fb6f5caa4c",
    "fast_dds_sync": "18fbe98c38002c96",
    "fast_dds_async": "99c6e873b780345f",
    "fast_dds_foxy": "c6f1af8e0719db40",
}


@pytest.mark.parametrize("preset", PRESETS)
def test_outcomes_are_those_of_the_committed_logs(preset):
    """A change of the model on purpose changes them, and asks for new logs."""
    assert digest(preset) == DIGESTS[preset]
