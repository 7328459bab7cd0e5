"""The world in compiled code: any number of threads, and machine code that follows its sources."""

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

from sfglab.rtps import CYCLONE_DDS, Flow, Scenario, run
from sfglab.rtps.engine import advance


def test_runs_in_threads_are_the_same_as_one_after_the_other_and_shapes_compile_nothing_again():
    flows = tuple(Flow(name=n, source=n, target="station", rate_hz=500) for n in "abc")
    given = {"vendor": CYCLONE_DDS, "duration_s": 5}
    scenarios = [Scenario(flows=flows[:count], **given) for count in (1, 2, 3, 3)]

    def play(scenario):
        outcome = run(scenario, seed=7)
        return [outcome.counts, *(flow.received_ns.tolist() for flow in outcome.flows.values())]

    with ThreadPoolExecutor(3) as threads:
        assert list(threads.map(play, scenarios)) == list(map(play, scenarios))
    assert len(advance.signatures) == 1


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
