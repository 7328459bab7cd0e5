"""A whole folder: every check appears with its subject, and our own rules are asked beside it."""

import pytest
from esslingen import FLEET, GO2, deployed

from sfglab.deploy.editor import editor_files
from sfglab.deploy.errors import DeployError
from sfglab.deploy.files import BundleFile
from sfglab.deploy.fleet_check import OwnRules, check_bundle
from sfglab.deploy.routers.dds_router import render_dds_router
from sfglab.deploy.verdicts import State
from sfglab.documents import Place
from sfglab.fleet.fleet_file import RouterSoftware
from sfglab.fleet.lint import Finding, Severity

ROUTER = "router/dds-router.yaml"


def of(check, files, deployment=None, own=()):
    return {v.subject: v for v in check_bundle(files, deployment or GO2, own) if v.check == check}


def rules(severity=Severity.ERROR, **options):
    def find(text, name):
        place = Place(file=name, line=3)
        yield Finding(
            severity=severity, code="c", place=place, what=f"{text} is wrong in {name}", why=""
        )

    return OwnRules(check="ours", pattern="systemd/*.service", rules=find, **options)


UNIT = {"systemd/a.service": BundleFile(text="unit")}


@pytest.mark.parametrize(
    ("files", "severity", "state", "says"),
    [
        (UNIT, Severity.ERROR, State.FAILS, "line 3: unit is wrong in a.service"),
        (UNIT, Severity.INFO, State.HOLDS, ""),
        ({}, Severity.ERROR, State.FAILS, "there is no such file"),
    ],
)
def test_our_own_rules_are_asked_of_their_files_which_must_be_there(files, severity, state, says):
    (verdict,) = of("ours", files, own=[rules(severity)]).values()
    assert (verdict.state, verdict.says) == (state, says)


def test_a_program_that_our_rules_miss_is_skipped_and_rules_that_refuse_a_file_fail_it():
    own = [rules(program="sfglab-no-such-program", install="apt install it")]
    skipped = of("sfglab-no-such-program", UNIT, own=own)["systemd/a.service"]
    assert (skipped.state, "apt install it" in skipped.says) == (State.SKIPPED, True)

    def refuse(text, name):
        raise DeployError("no unit")

    own = [OwnRules(check="ours", pattern="*.service", rules=refuse)]
    assert of("ours", UNIT, own=own)["systemd/a.service"].says == "no unit"


def test_anothers_router_needs_its_file_and_it_must_be_the_policys():
    dds, check = deployed(router=RouterSoftware.DDS_ROUTER), "router's file"
    assert of(check, {}, dds)[ROUTER].says == "there is no such file"
    good = render_dds_router(FLEET, "go2")
    texts = {good: State.HOLDS, good.replace('"rt/tf"', '"rt/*"'): State.FAILS, "a: [": State.FAILS}
    for text, state in texts.items():
        assert of(check, {ROUTER: BundleFile(text=text)}, dds)[ROUTER].state is state
    assert of(check, {}) == {}


def test_every_file_is_searched_for_secrets_and_every_editor_file_has_a_verdict():
    files = editor_files(GO2) | UNIT
    assert set(of("no secrets", files)) == set(files)
    assert set(of("editor's file", files)) == set(editor_files(GO2))
