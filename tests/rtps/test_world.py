"""The world in compiled code: any number of threads, no arrays of its own, and its heap of events."""

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sfglab.rtps import CYCLONE_DDS, Flow, Medium, Scenario, run
from sfglab.rtps.engine import advance
from sfglab.rtps.world import new_heap, pop, push


def test_runs_in_threads_are_the_same_as_one_after_the_other_and_shapes_compile_nothing_again():
    flows = tuple(Flow(name=n, source=n, target="station", rate_hz=500) for n in "abc")
    given = {"medium": Medium(loss=0.1), "vendor": CYCLONE_DDS, "duration_s": 5}
    scenarios = [Scenario(flows=flows[:count], **given) for count in (1, 2, 3, 3)]

    def play(scenario):
        outcome = run(scenario, seed=7)
        return outcome.counts, [flow.received_ns.tolist() for flow in outcome.flows.values()]

    with ThreadPoolExecutor(3) as threads:
        assert list(threads.map(play, scenarios)) == list(map(play, scenarios))
    assert len(advance.signatures) == 1


events = st.tuples(
    st.integers(0, 5) | st.integers(0, 2**62), st.integers(0, 6), st.integers(0, 2**20 - 1)
)


@settings(deadline=None)  # the first example compiles
@given(st.lists(events, max_size=200))
def test_events_come_out_by_time_and_then_as_they_went_in_and_a_full_heap_says_so(given):
    slots, sizes = new_heap(len(given))
    for event in given:
        push(slots, sizes, *event)
    with pytest.raises(IndexError, match="full"):
        push(slots, sizes, 0, 0, 0)
    out = [pop(slots, sizes) for _ in given]
    assert out == sorted(given, key=lambda event: event[0]), "sorting is stable"


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
