"""A real build of an agent's application image, from a Debian that debootstrap makes."""

import os
import shutil
import subprocess
from dataclasses import replace

import pytest
from esslingen import deployed

from sfglab.deploy.bases import base_of
from sfglab.deploy.bundle import bundle_of, write_bundle
from sfglab.deploy.deployment import USER_ID
from sfglab.deploy.release import SOURCE, make_release
from sfglab.fleet.fleet_file import Accelerator, RosDistribution

PROGRAMS = ("buildah", "debootstrap")
BASE, IMAGE = "localhost/sfglab-trial-base", "localhost/sfglab-trial"


@pytest.fixture
def buildah(tmp_path):
    """Buildah with images of its own."""
    places = ("--root", tmp_path / "store", "--runroot", tmp_path / "run")
    command = ["buildah", "--storage-driver", "vfs", *map(str, places)]

    def run(*words, check=True):
        done = subprocess.run([*command, *words], capture_output=True, text=True, check=check)
        return done.stdout.strip()

    yield run
    run("rm", "--all", check=False)
    run("rmi", "--all", "--force", check=False)


@pytest.mark.slow
@pytest.mark.skipif(
    os.geteuid() != 0 or not all(map(shutil.which, PROGRAMS)),
    reason=f"needs root, {' and '.join(PROGRAMS)}",
)
def test_an_image_is_built_from_a_local_base_and_runs_as_its_user(tmp_path, buildah):
    made = deployed("workstation", ros=RosDistribution.NONE)
    release, wheel = make_release(SOURCE, made.release.fleet_text)
    made = replace(made, accelerator=Accelerator.NONE, release=release)
    base, context = tmp_path / "base", tmp_path / "context"
    distribution = base_of(made).distribution.value
    subprocess.run(["debootstrap", "--variant=minbase", distribution, base / "root"], check=True)
    (base / "Dockerfile").write_text("FROM scratch\nADD root /\n")
    write_bundle(bundle_of(made, wheel), context)
    build = ("build", "--isolation=chroot", "--target=application")
    buildah("build", f"--tag={BASE}", str(base))
    buildah(*build, f"--tag={IMAGE}", f"--build-arg=BASE_IMAGE={BASE}", str(context))
    container = buildah("from", "--pull-never", IMAGE)
    run = ("run", "--isolation=chroot", container, "--")
    assert buildah(*run, "id", "-u") == str(USER_ID)
    assert buildah(*run, "sfglab", "--version") == release.version
