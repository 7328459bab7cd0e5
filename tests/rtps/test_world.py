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

from sfglab.rtps import CYCLONE_DDS, FAST_DDS, Flow, Medium, Scenario, run
from sfglab.rtps.state import Event
from sfglab.rtps.world import World, compiled, new_heap, pop, push


class Read(NamedTuple):
    scale: np.ndarray
    cube: np.ndarray


class Written(NamedTuple):
    small: np.ndarray
    table: np.ndarray
    word: np.ndarray


@compiled
def fill(world):
    """Write into each cell of a table where it is, and what the other arrays say there."""
    rows, columns = world.table.shape
    for row in range(rows):
        line = world.table[row]
        for column in range(columns):
            line[column] = 100 * row + column + world.cube[row, column, -1]
            world.small[column] += 1
    world.word[0] += np.uint64(world.cube.shape[2])
    world.table[-1, -1] = int(world.scale[0] * world.cube.size)


@compiled
def allocate(world):
    return np.zeros(world.table.shape[0])[0]


def parts(rows, columns, depth):
    cube = np.arange(rows * columns * depth, dtype=np.int32).reshape(rows, columns, depth)
    return Read(np.array([0.5, 0]), cube), Written(
        np.zeros(columns, np.int8), np.zeros((rows, columns), np.int64), np.zeros(1, np.uint64)
    )


@pytest.mark.parametrize("shape", [(1, 1, 1), (1, 7, 2), (5, 1, 3), (3, 4, 5)])
def test_compiled_code_reads_and_writes_the_very_arrays(shape):
    rows, columns, depth = shape
    read, written = parts(*shape)
    fill(World(read, written))
    expected = 100 * np.arange(rows)[:, None] + np.arange(columns) + read.cube[:, :, -1]
    expected[-1, -1] = read.cube.size // 2
    assert np.array_equal(written.table, expected)
    assert (written.small == rows).all()
    assert written.word[0] == depth


def test_a_world_keeps_its_arrays():
    worlds = [World(*parts(300, 40, 5)) for _ in range(20)]
    for world in worlds:
        fill(world)  # would write into freed memory


def test_shapes_do_not_compile_anew():
    fill(World(*parts(2, 3, 4)))
    before = len(fill.signatures)
    fill(World(*parts(4, 3, 2)))
    assert len(fill.signatures) == before == 1


def test_what_would_need_reference_counting_is_refused():
    with pytest.raises(TypingError, match="zeros"):
        allocate(World(*parts(1, 1, 1)))


@pytest.mark.parametrize("vendor", [FAST_DDS, CYCLONE_DDS])
def test_runs_in_threads_are_the_same_as_one_after_the_other(vendor):
    flows = tuple(Flow(name=n, source=n, target="station", rate_hz=500) for n in "abc")
    scenario = Scenario(flows=flows, medium=Medium(loss=0.1), vendor=vendor, duration_s=5)
    alone = [run(scenario, seed=seed) for seed in range(6)]
    with ThreadPoolExecutor(3) as threads:
        together = list(threads.map(lambda seed: run(scenario, seed=seed), range(6)))
    for one, other in zip(alone, together, strict=True):
        assert one.counts == other.counts
        for name, flow in one.flows.items():
            assert np.array_equal(flow.received_ns, other.flows[name].received_ns)
            assert np.array_equal(flow.fate, other.flows[name].fate)


# --- The event heap: earliest first, equal times in the order of insertion.


times = st.integers(0, 5) | st.integers(0, 2**62)
kinds = st.sampled_from([int(kind) for kind in Event])
events = st.lists(st.tuples(times, kinds, st.integers(0, 2**20 - 1)), min_size=1, max_size=200)


@settings(deadline=None)  # the first example compiles
@given(events, events | st.just([]))
def test_events_come_out_by_time_and_then_as_they_went_in_also_those_that_come_in_between(
    first, second
):
    slots, sizes = new_heap(len(first) + len(second))
    for event in first:
        push(slots, sizes, *event)
    earliest = pop(slots, sizes)
    rest = sorted(first, key=lambda event: event[0])[1:]
    for event in second:
        push(slots, sizes, *event)
    out = [pop(slots, sizes) for _ in range(sizes[0])]
    assert earliest == min(first, key=lambda event: event[0])
    assert out == sorted(rest + second, key=lambda event: event[0]), "sorting is stable"
    assert sizes[0] == 0


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


def test_machine_code_on_disk_follows_what_stands_in_other_files(tmp_path):
    (tmp_path / "outer.py").write_text(OUTER)
    env = os.environ | {
        "NUMBA_CACHE_DIR": str(tmp_path / "cache"),
        "PYTHONPATH": os.pathsep.join(sys.path),
    }

    def run_with(number: int) -> str:
        (tmp_path / "inner.py").write_text(INNER.format(number))
        program = [sys.executable, "-B", "outer.py"]
        return subprocess.run(
            program, cwd=tmp_path, env=env, capture_output=True, text=True, check=True
        ).stdout

    assert [run_with(number) for number in (1, 1, 2)] == ["2 0\n", "2 1\n", "3 0\n"]
