"""An agent's images in three layers (paper A, section 4.4, Fig. 5): hardware base, common adapter, application.

A multi-stage Dockerfile is rendered from the deployment, checked by our own rules, and built by whichever
builder a machine has. An application image is immutable: sfglab's wheel, a pinned lock and the fleet file are
inside, each by its digest.
"""

from __future__ import annotations

from sfglab.deploy.images.bases import JETPACK, BaseImage, Distribution, base_of
from sfglab.deploy.images.building import BUILDERS, build_command, find_builder
from sfglab.deploy.images.dockerfile import STAGES, image_files
from sfglab.deploy.images.dockerfile_check import check_dockerfile
from sfglab.deploy.images.lock import AGENT_ROOTS, agent_lock
from sfglab.deploy.images.release import SOURCE, build_wheel, make_release
from sfglab.deploy.images.trial import TrialCheck, trial_build
from sfglab.deploy.images.wheelhouse import wheelhouse

__all__ = [
    "AGENT_ROOTS",
    "BUILDERS",
    "JETPACK",
    "SOURCE",
    "STAGES",
    "BaseImage",
    "Distribution",
    "TrialCheck",
    "agent_lock",
    "base_of",
    "build_command",
    "build_wheel",
    "check_dockerfile",
    "find_builder",
    "image_files",
    "make_release",
    "trial_build",
    "wheelhouse",
]
