import json
import os
import platform
import re
import socket
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from sfglab import __version__
from sfglab.qos import DEFAULT, Durability, History, QoSProfile, Reliability
from sfglab.record import LogError, run_context
from sfglab.record.metadata import offered_qos_profiles, strings_from_values, values_from_strings

INFINITE = {"sec": 9223372036, "nsec": 854775807}
json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)


class Mode(Enum):
    LIVE = "live"


@dataclass(frozen=True)
class Inner:
    rate_hz: float
    modes: tuple[Mode, ...]


def test_text_stays_text_and_the_rest_is_json():
    cases = [
        ("plain", "plain"),
        (3, "3"),
        ("3", '"3"'),
        (Inner(2.5, (Mode.LIVE,)), '{"rate_hz": 2.5, "modes": ["live"]}'),
        (None, "null"),
        (Mode.LIVE, '"live"'),
        (np.float64(0.5), "0.5"),
        (np.arange(3), "[0, 1, 2]"),
        ({"k": np.int32(1)}, '{"k": 1}'),
    ]
    values = {str(i): value for i, (value, _) in enumerate(cases)}
    assert list(strings_from_values("config", values).values()) == [said for _, said in cases]


@given(st.dictionaries(st.text(), json_values, max_size=5))
def test_every_value_of_json_comes_back(values):
    strings = strings_from_values("config", values)
    assert all(isinstance(text, str) for text in strings.values())
    assert values_from_strings(strings) == values


def test_what_has_no_form_in_json_is_refused():
    for values in ({"x": object()}, {"x": "\ud800"}, {"\ud800": 1}):
        with pytest.raises(LogError, match=r"metadata 'config': .* cannot be kept"):
            strings_from_values("config", values)


def test_profiles_are_written_as_rosbag2_of_humble_does_with_the_numbers_of_rmw():
    numbers = {"history": 1, "depth": 10, "reliability": 1, "durability": 2, "liveliness": 1}
    durations = dict.fromkeys(("deadline", "lifespan", "liveliness_lease_duration"), INFINITE)
    expected = numbers | durations | {"avoid_ros_namespace_conventions": False}
    assert yaml.safe_load(offered_qos_profiles(DEFAULT)) == [expected]
    profile = QoSProfile(
        reliability=Reliability.BEST_EFFORT,
        durability=Durability.TRANSIENT_LOCAL,
        history=History.KEEP_ALL,
        deadline_ns=1_500_000_000,
    )
    [written] = yaml.safe_load(offered_qos_profiles(profile))
    assert (written["reliability"], written["durability"], written["history"]) == (2, 1, 2)
    assert written["deadline"] == {"sec": 1, "nsec": 500_000_000}


def test_context_names_versions_and_machine_but_neither_place_nor_host():
    context = run_context()
    assert context["sfglab"] == __version__
    assert context["python"] == platform.python_version()
    assert context["libraries"]["numpy"] == np.__version__
    assert context["machine"]["usable_cores"] == len(os.sched_getaffinity(0))
    assert context["machine"]["cpu"]
    text = json.dumps(context)
    assert socket.gethostname() not in text
    assert str(Path.home()) not in text
    assert not re.search(r'"/', text)
    if source := context["source"]:
        assert re.fullmatch(r"[0-9a-f]{40}", source["git_commit"])
        assert isinstance(source["git_clean"], bool)
    assert values_from_strings(strings_from_values("run", context)) == context
