"""Scripts, Dockerfiles and secrets: what real linters find arrives, and what is missing is said."""

import os
import re
import subprocess
import sys
import tempfile

import pytest
from esslingen import needs
from esslingen import program as shell_program
from hypothesis import given
from hypothesis import strategies as st

from sfglab.deploy.errors import DeployError, MissingProgramError
from sfglab.deploy.files import PROGRAM, BundleFile
from sfglab.deploy.programs import find_program, run_program
from sfglab.deploy.text_check import check_dockerfiles, check_secrets, check_shell, leaks
from sfglab.deploy.verdicts import State, Verdict, render_verdicts


@pytest.fixture
def nothing_installed(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(sys, "executable", str(tmp_path / "python"))


def program(text):
    return BundleFile(text=f"#!/usr/bin/env bash\n{text}\n", mode=PROGRAM)


def by_subject(verdicts, check):
    return {v.subject: v for v in verdicts if v.check == check}


@needs("shellcheck")
def test_shellchecks_findings_belong_to_their_script_and_scripts_find_each_other():
    library = BundleFile(text="# shellcheck shell=bash\nsay() { printf '%s\\n' \"$1\"; }\n")
    good = program('. "$(dirname "$0")/lib.sh"\nsay "$HOME"')
    scripts = {"h/lib.sh": library, "h/good.sh": good, "h/bad.sh": program("rm -r $1/*")}
    found = by_subject(check_shell(scripts), "shellcheck")
    assert [found[name].state for name in scripts] == [State.HOLDS, State.HOLDS, State.FAILS]
    assert re.search("line 2: .*SC2086", found["h/bad.sh"].says)


@pytest.mark.parametrize(
    ("file", "words"),
    [
        (BundleFile(text="#!/bin/sh\ntrue\n"), "755"),
        (BundleFile(text="#!/bin/sh\ntrue\n", mode=0o744), "744"),
        (BundleFile(text="#!/bin/sh\r\ntrue\r\n", mode=PROGRAM), "CR LF"),
    ],
)
def test_a_script_that_nobody_can_start_fails(file, words, nothing_installed):
    found = by_subject(
        check_shell({"a": file, "b.sh": BundleFile(text="true\n")}), "programs can be started"
    )
    assert words in found["a"].says
    assert found["b.sh"].state is State.HOLDS


def test_without_linters_checks_are_listed_as_skipped_and_a_folder_needs_a_dockerfile(
    nothing_installed,
):
    assert [v.state for v in check_shell({"compose.yaml": BundleFile(text="")})] == [State.SKIPPED]
    found = by_subject(
        check_shell({"a.sh": program("true"), "b.sh": program("true")}), "shellcheck"
    )
    assert [v.state for v in found.values()] == [State.SKIPPED] * 2
    assert "pip install '.[deploy]'" in found["a.sh"].says
    assert [v.state for v in check_dockerfiles({})] == [State.FAILS]
    found = check_dockerfiles({"Dockerfile": BundleFile(text="FROM a:1\n")})
    assert [v.state for v in found] == [State.SKIPPED]
    assert "hadolint" in found[0].says


def test_a_linter_that_does_not_work_fails_and_says_so(monkeypatch, tmp_path):
    shell_program(tmp_path / "shellcheck", "echo no such format >&2\nexit 4")
    monkeypatch.setattr(sys, "executable", str(tmp_path / "python"))
    found = by_subject(check_shell({"a.sh": program("true")}), "shellcheck")["a.sh"]
    assert (found.state, "status 4: no such format" in found.says) == (State.FAILS, True)


@needs("hadolint")
def test_hadolints_findings_arrive_with_line_and_rule():
    good = "FROM debian:12.5@sha256:" + "0" * 64 + '\nUSER 10001:10001\nENTRYPOINT ["/bin/true"]\n'
    texts = {
        "Dockerfile": good,
        "Dockerfile.bad": "FROM debian:latest\n",
        "Dockerfile.none": "FRO ä\n",
    }
    files = {name: BundleFile(text=text) for name, text in texts.items()}
    found = by_subject(check_dockerfiles(files), "hadolint")
    assert [found[name].state for name in texts] == [State.HOLDS, State.FAILS, State.FAILS]
    assert re.search("^line 1: .*DL3007", found["Dockerfile.bad"].says)
    assert "DL1000" in found["Dockerfile.none"].says


def test_programs_run_with_their_files_alone_and_without_the_users_settings(monkeypatch):
    monkeypatch.setenv("SHELLCHECK_OPTS", "--exclude=SC2086")
    code = "import os; print(sorted(os.listdir()), open('d/a').read(), 'SHELLCHECK_OPTS' in os.environ)"
    assert run_program((sys.executable, "-c", code), {"d/a": "ä"}) == (0, "['d'] ä False\n")


def test_a_program_that_hangs_or_does_not_start_is_an_error_and_leaves_nothing(
    monkeypatch, tmp_path
):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "t"))
    (tmp_path / "t").mkdir()
    pid = tmp_path / "pid"
    code = f"import os, time; open({str(pid)!r}, 'w').write(str(os.getpid())); time.sleep(60)"
    with pytest.raises(DeployError, match="no answer within 1 s"):
        run_program((sys.executable, "-S", "-c", code), {}, timeout_s=1)
    with pytest.raises(ProcessLookupError):
        os.kill(int(pid.read_text()), 0)
    assert list((tmp_path / "t").iterdir()) == []
    with pytest.raises(DeployError, match="did not start"):
        run_program((str(tmp_path / "none"),), {})


def test_nothing_stays_behind_on_interruption(monkeypatch, tmp_path):
    def interrupt(*_args, **_options):
        raise KeyboardInterrupt

    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(subprocess, "run", interrupt)
    with pytest.raises(KeyboardInterrupt):
        run_program(("true",), {"a": ""})
    assert list(tmp_path.iterdir()) == []


def test_a_program_is_found_beside_python_first_then_on_the_path(monkeypatch, tmp_path):
    for folder in ("beside", "path"):
        shell_program(tmp_path / folder / "tool")
    monkeypatch.setattr(sys, "executable", str(tmp_path / "beside" / "python"))
    monkeypatch.setenv("PATH", str(tmp_path / "path"))
    assert find_program("tool") == str(tmp_path / "beside" / "tool")
    (tmp_path / "beside" / "tool").unlink()
    assert find_program("tool") == str(tmp_path / "path" / "tool")
    (tmp_path / "path" / "tool").unlink()
    with pytest.raises(MissingProgramError, match="apt install tool"):
        find_program("tool", "apt install tool")


DASHES = "-----"
SECRETS = [
    f"{DASHES}BEGIN OPENSSH PRIVATE KEY{DASHES}",
    f"{DASHES}BEGIN PRIVATE KEY{DASHES}",
    "id: AKIA" + "ABCDEFGHIJKLMNOP",
    "x ghp_" + "a1B2" * 9,
    "glpat-" + "x" * 20,
    "nvapi-" + "x" * 44,
    "url = https://user:" + "hunter22@example.org/",
    "WIFI_PASSWORD=" + "correcthorse",
    "password: " + "correcthorse",
    '  "api_key": "' + 'abcdef123456"',
    "export SFG_TOKEN='" + "abcdef123456'",
]


@pytest.mark.parametrize("line", SECRETS)
def test_secrets_are_found_by_line_and_not_repeated(line):
    files = {"a": BundleFile(text=f"first line\n{line}\n"), "b": BundleFile(text="")}
    found, none = check_secrets(files)
    assert (found.subject, found.state, none.state) == ("a", State.FAILS, State.HOLDS)
    assert re.fullmatch("line 2: it looks like [^;]*", found.says)
    assert not any(secret in found.says for secret in ("correcthorse", "hunter22"))


HARMLESS = [
    "secretstorage==3.3.3 \\",
    "PASSWORD=${PASSWORD:?where}",
    "password_file: /run/secrets/wifi",
    "TOKEN=/run/secrets/token",
    '"password": true,',
    "token = read_token(path)",
    "# the password is asked for when it is needed",
    "signed-by=/usr/share/keyrings/ros.gpg",
    "keys: [a, b, c]",
    "DDS_KEY=",
    "frequency_key: $value",
    "https://example.org:8080/a@b",
    "git@github.com:org/repo.git",
]


@pytest.mark.parametrize("line", HARMLESS)
def test_what_only_resembles_a_secret_passes(line):
    assert list(leaks(line)) == []


@given(st.text(alphabet="0123456789abcdef", min_size=64, max_size=64))
def test_no_digest_is_a_secret(digest):
    assert list(leaks(f"    --hash=sha256:{digest}\nimage: x@sha256:{digest}\n{digest}\n")) == []


def test_the_table_begins_with_what_fails_and_ends_with_counts():
    says = "x is not installed: apt install x"
    rows = [
        Verdict(check="c1", subject="a.sh", state=State.HOLDS),
        Verdict(check="c2", subject="long/name.sh", state=State.SKIPPED, says=says),
        Verdict(check="c3", subject="b", state=State.FAILS, says="line 1: wrong"),
    ]
    lines = render_verdicts(rows).splitlines()
    assert lines == [
        "fails    b             c3",
        "    line 1: wrong",
        "skipped  long/name.sh  c2",
        "    x is not installed: apt install x",
        "holds    a.sh          c1",
        "1 held, 1 failed, 1 skipped",
    ]
    short = render_verdicts(rows, every=False)
    assert "c1" not in short
    assert short.endswith(lines[-1])
    assert render_verdicts([]) == "0 held, 0 failed, 0 skipped"
