"""The world in compiled code: the very arrays in any number of threads; and its heap of events."""

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba.core.errors import TypingError

from sfglab.rtps import CYCLONE_DDS, Flow, Medium, Scenario, run
from sfglab.rtps.world import World, compiled, new_heap, pop, push

PAIR = np.dtype((np.record, [("scale", np.float64), ("words", np.int64, 3)]))


class Parts(NamedTuple):
    one: np.ndarray
    several: np.ndarray
    cube: np.ndarray
    table: np.ndarray


@compiled
def fill(world):
    """Write into each cell of a table where it is, and what the other arrays say there."""
    for row in range(world.table.shape[0]):
        for column in range(world.table.shape[1]):
            world.table[row, column] = 100 * row + column + world.cube[row, column, -1]
        world.several[row].words[2] = row
    world.one.scale *= 2


@compiled
def allocate(world):
    return np.zeros(world.table.shape[0])[0]


def parts(rows, columns, depth):
    cube = np.arange(rows * columns * depth, dtype=np.int32).reshape(rows, columns, depth)
    table = np.zeros((rows, columns), np.int8)
    return Parts(np.ones((), PAIR), np.zeros(rows, PAIR), cube, table)


@pytest.mark.parametrize("shape", [(1, 1, 1), (1, 7, 2), (5, 1, 3), (3, 4, 1)])
def test_compiled_code_reads_and_writes_the_very_arrays_and_records(shape):
    rows, columns, _ = shape
    given = parts(*shape)
    fill(World(given))
    places = 100 * np.arange(rows)[:, None] + np.arange(columns)
    assert np.array_equal(given.table, (places + given.cube[:, :, -1]).astype(np.int8))
    assert given.several["words"][:, 2].tolist() == list(range(rows))
    assert given.one["scale"] == 2
    assert len(fill.signatures) == 1, "shapes compile nothing again"


def test_arrays_that_would_need_reference_counting_are_refused():
    with pytest.raises(TypingError, match="zeros"):
        allocate(World(parts(1, 1, 1)))


def test_runs_in_threads_are_the_same_as_one_after_the_other():
    flows = tuple(Flow(name=n, source=n, target="station", rate_hz=500) for n in "abc")
    scenario = Scenario(flows=flows, medium=Medium(loss=0.1), vendor=CYCLONE_DDS, duration_s=5)
    with ThreadPoolExecutor(3) as threads:
        together = list(threads.map(lambda seed: run(scenario, seed=seed), range(6)))
    for seed, outcome in enumerate(together):
        alone = run(scenario, seed=seed)
        assert alone.counts == outcome.counts
        for name, flow in alone.flows.items():
            assert np.array_equal(flow.received_ns, outcome.flows[name].received_ns)


events = st.tuples(
    st.integers(0, 5) | st.integers(0, 2**62), st.integers(0, 6), st.integers(0, 2**20 - 1)
)


@settings(deadline=None)  # the first example compiles
@given(st.lists(events, min_size=1, max_size=200), st.lists(events, max_size=200))
def test_events_come_out_by_time_and_then_as_they_went_in(first, later):
    slots, sizes = new_heap(len(first) + len(later))
    for event in first:
        push(slots, sizes, *event)
    earliest = pop(slots, sizes)
    for event in later:
        push(slots, sizes, *event)
    assert earliest == min(first, key=lambda event: event[0])
    first.remove(earliest)
    out = [pop(slots, sizes) for _ in range(sizes[0])]
    assert out == sorted(first + later, key=lambda event: event[0]), "sorting is stable"


def test_a_full_heap_says_so():
    slots, sizes = new_heap(1)
    push(slots, sizes, 1, 0, 0)
    with pytest.raises(IndexError, match="full"):
        push(slots, sizes, 2, 0, 0)


INNER = """
from sfglab.rtps.world import compiled

@compiled
def inner(a):
    return a + {}
"""
OUTER = """
from inner import inner
from sfglab.rtps.world import compiled

@compiled
def outer(a):
    return inner(a)

print(outer(1), sum(outer.stats.cache_hits.values()))
"""


def test_machine_code_on_disk_follows_the_sources_of_other_files(tmp_path):
    (tmp_path / "outer.py").write_text(OUTER)
    path = os.pathsep.join(sys.path)
    env = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": path}
    printed = []
    for number in (1, 1, 2):
        (tmp_path / "inner.py").write_text(INNER.format(number))
        program = [sys.executable, "-B", "outer.py"]
        printed.append(subprocess.check_output(program, cwd=tmp_path, env=env, text=True))
    assert printed == ["2 0\n", "2 1\n", "3 0\n"]
