"""CI's workflow names what exists: notebooks, folders, targets of make and commands."""

import json
import re
import shlex
from pathlib import Path

import pytest
import yaml

from sfglab.cli import app
from sfglab.lab.experiment import PROFILES

ROOT = Path(__file__).parents[1]
WORKFLOW = yaml.safe_load((ROOT / ".github" / "workflows" / "ci.yml").read_text("utf-8"))
STEPS = [step for job in WORKFLOW["jobs"].values() for step in job["steps"]]
LINES = [
    line.strip()
    for step in STEPS
    for line in step.get("run", "").splitlines()
    if line.strip() and line.strip() != "done"
]


def test_every_job_has_steps_and_there_is_one_with_plain_papermill():
    assert LINES
    loop = "\n".join(LINES)
    assert 'for notebook in notebooks/*.ipynb; do\npapermill "$notebook"' in loop
    assert "pip install --no-deps ." in LINES, "not editable"


@pytest.mark.parametrize("line", LINES)
def test_a_line_names_what_exists(line):
    for path in re.findall(r"(?<![\w/$])notebooks/[\w.]+\.ipynb", line.replace("runs/", "")):
        assert (ROOT / path).is_file(), path
    words = shlex.split(line)
    targets = (ROOT / "Makefile").read_text("utf-8")
    if words[0] == "make":
        assert re.search(rf"^{words[1]}:", targets, re.MULTILINE), words[1]
    commands = [c.name or c.callback.__name__ for c in app.registered_commands]
    commands += [group.name for group in app.registered_groups]
    if words[0].endswith("sfglab"):
        assert words[1] in commands
    for profile in re.findall(r"(?:-p profile |PROFILE=)(\w+)", line):
        assert profile in PROFILES
    for lock in re.findall(r"[\w./]+\.lock|environment\.yml", line):
        assert (ROOT / lock).is_file()


def test_the_dev_container_sets_up_and_opens_jupyterlab_by_targets_of_make():
    container = json.loads((ROOT / ".devcontainer" / "devcontainer.json").read_text("utf-8"))
    targets = (ROOT / "Makefile").read_text("utf-8")
    for key in ("postCreateCommand", "postAttachCommand"):
        program, target, *_ = container[key].split()
        assert program == "make"
        assert re.search(rf"^{target}:", targets, re.MULTILINE)
