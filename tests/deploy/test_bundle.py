"""A fleet file becomes bundles: what cannot be deployed is refused with its place, and workspaces are packed."""

from dataclasses import replace

import pytest
from esslingen import FILE, RELEASE, deployed, fleet_with

from sfglab.deploy.bundle import load_source, prepare, workspace_members
from sfglab.deploy.deployment import deployment_of
from sfglab.deploy.errors import DeployError
from sfglab.fleet.fleet_file import Accelerator


def test_an_agent_without_a_host_or_an_accelerator_is_refused():
    with pytest.raises(DeployError, match="host: nothing is given, needed: the machine that go2"):
        deployed(agent={"host": None})
    fleet = fleet_with(host={"accelerator": None})
    with pytest.raises(DeployError, match=r"accelerator: given 'auto'.*jetson, cuda, rocm"):
        deployment_of(fleet, "go2", RELEASE)
    made = deployment_of(fleet, "go2", RELEASE, Accelerator.JETSON)
    assert made.accelerator is Accelerator.JETSON


def test_a_workspace_is_packed_without_hidden_and_built_files(tmp_path):
    with pytest.raises(DeployError, match="there is no folder src in it; give a colcon"):
        workspace_members(tmp_path)
    for path in ("src/p/package.xml", "src/p/.git/x", "src/p/run.sh", "build/made"):
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_text(path)
    (tmp_path / "src/p/run.sh").chmod(0o755)
    modes = {path: member.mode for path, member in workspace_members(tmp_path).items()}
    assert modes == {"workspace/src/p/package.xml": 0o644, "workspace/src/p/run.sh": 0o755}


def test_equal_contents_have_one_name_without_a_plus_and_any_change_is_another_release():
    source = load_source(FILE)
    made = replace(RELEASE, version="1.2+x")
    other_lock = replace(made, lock=RELEASE.lock.replace("numpy==", "numpy==1!"))
    other_fleet = replace(made, fleet_text="fleet: other\n")
    names = []
    wheels = [b"wheel"] * 4 + [b"another wheel"]
    for release, wheel in zip((made, made, other_fleet, other_lock, made), wheels, strict=True):
        ((_, bundle),) = prepare(source, release, wheel, agents=["pi1"])
        names.append(bundle.tag)
    assert names[0] == names[1]
    assert names[0].startswith("1.2-x-")
    assert len(set(names)) == 4
