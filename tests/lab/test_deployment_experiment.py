"""The deployment experiment: each fact has a row, a missing program keeps its part open, and a fault shows."""

import asyncio
import os
import shutil
from dataclasses import replace

import pytest
from made_logs import DATA, ran, reference

import sfglab
from sfglab.deploy.bundle import load_source, prepare
from sfglab.deploy.files import BundleFile
from sfglab.deploy.release import SOURCE, make_release
from sfglab.lab.experiments.deployment import exp, facts_of
from sfglab.lab.experiments.deployment.containers import ask_containers
from sfglab.lab.experiments.deployment.experiment import ask_hooks
from sfglab.lab.experiments.deployment.facts import (
    CONTAINERS,
    FACTS,
    HOOKS,
    LOCAL_IMAGE,
    TRIAL,
    Outcome,
)
from sfglab.lab.experiments.deployment.image import PROGRAMS, ask_image


def pairs_of(*agents):
    source = load_source(DATA / "fleets" / "esslingen.yaml")
    return prepare(source, *make_release(SOURCE, source.text), agents=agents)


def test_a_run_has_a_row_for_each_fact_and_names_missing_programs(tmp_path):
    run = ran(exp, tmp_path / "run.mcap", agents=["steamdeck"])
    facts = run["fact"].set_index("fact")["outcome"]
    assert list(facts.index) == [fact.name for fact in FACTS]
    assert set(facts) == {Outcome.CONFIRMED.value, Outcome.MISSING.value}
    assert facts[TRIAL] == Outcome.CONFIRMED.value
    measured = exp.measure(run)["A-DEPLOY"]
    assert (measured.estimate.value, measured.how.value, measured.ends) == (1.0, "exact", {})
    assert "systemd cannot be confirmed without systemd on a machine" in measured.reason


def test_a_fact_that_is_refused_shows_and_a_part_counts_if_all_its_facts_were_asked():
    assert exp.measure(reference(exp))["A-DEPLOY"].ends == {}, "the log leaves all parts open"
    run = reference(exp)
    table = run.table("fact")
    table.loc[table["program"] == "shellcheck", "outcome"] = Outcome.REFUSED.value
    measured = exp.measure(run)["A-DEPLOY"]
    assert (measured.estimate.value, measured.how.value) == (0.5, "live")
    assert "shell scripts are accepted: shellcheck" in measured.reason
    facts = facts_of(run)
    facts.loc[facts["end"].isin([HOOKS, CONTAINERS]), "outcome"] = Outcome.CONFIRMED.value
    assert exp.measure(run)["A-DEPLOY"].ends == {CONTAINERS: 1.0, HOOKS: 1.0}


@pytest.mark.parametrize(
    ("line", "limit_s", "fault"),
    [
        (b'date +%N > "$SFGLAB_ROOT/now"\n', 60.0, "steamdeck: a second run changes files"),
        (b"sleep 100\n", 1.0, "steamdeck: env: ended with status 124"),
    ],
)
def test_hooks_that_do_not_do_what_they_say_or_do_not_end_are_refused(
    monkeypatch, tmp_path, line, limit_s, fault
):
    monkeypatch.setattr("sfglab.lab.experiments.deployment.experiment._HOOKS_S", limit_s)
    ((deployment, bundle),) = pairs_of("steamdeck")
    path = "hooks/30-service.sh"
    text = bundle.members[path].data + line
    changed = replace(bundle, members=bundle.members | {path: BundleFile(data=text, mode=0o755)})
    assert ask_hooks([(deployment, changed)], tmp_path)[TRIAL].startswith(fault)


@pytest.mark.slow
@pytest.mark.live
@pytest.mark.netns
def test_agents_meet_over_their_bridges_and_routers_and_nothing_of_their_own_gets_out(tmp_path):
    faults = asyncio.run(ask_containers(pairs_of("go2", "workstation"), tmp_path))
    assert list(faults.values()) == ["", "", ""]


def image_of(folder):
    """Return the fault of an image that is built; None if it was not built."""
    source = load_source(DATA / "fleets" / "esslingen.yaml")
    release, wheel = make_release(SOURCE, source.text)
    ((deployment, _),) = prepare(source, release, wheel, agents=["workstation"])
    return ask_image(deployment, wheel, folder).get(LOCAL_IMAGE)


@pytest.mark.slow
@pytest.mark.skipif(
    os.geteuid() != 0 or not all(map(shutil.which, PROGRAMS)),
    reason=f"needs root, {' and '.join(PROGRAMS)}",
)
def test_an_image_is_built_from_a_local_base_and_runs_as_its_user(tmp_path):
    assert image_of(tmp_path) == ""


@pytest.mark.parametrize(
    ("debian", "user", "fault"),
    [
        ("exit 0", "10001", ""),
        ("exit 0", "0", f"user and version: 0, {sfglab.__version__}"),
        ("exit 1", "10001", None),
    ],
)
def test_an_image_is_judged_by_its_user_and_version(monkeypatch, tmp_path, debian, user, fault):
    version = f"echo {user}; echo {sfglab.__version__}"
    for name, text in zip(PROGRAMS, (version, debian), strict=True):
        (tmp_path / name).write_text(f"#!/bin/sh\n{text}\n")
        (tmp_path / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    assert image_of(tmp_path) == fault
