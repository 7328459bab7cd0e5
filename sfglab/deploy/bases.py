"""Base images of the first layer of agents' images: one table, by accelerator, processor and distribution.

Sources: tags as their makers publish them on Docker Hub and NVIDIA NGC. ROS 2 binaries exist for one Ubuntu
release each: Humble for 22.04, Jazzy for 24.04 (REP 2000). NVIDIA's image for JetPack 6 (L4T r36) is Ubuntu
22.04 for arm64; ROCm's images and CUDA's for desktop cards are used on amd64 alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from itertools import product
from typing import TYPE_CHECKING

from sfglab.deploy.errors import DeployError
from sfglab.fleet.fleet_file import Accelerator, Architecture, RosDistribution

if TYPE_CHECKING:
    from sfglab.deploy.deployment import Deployment


#: The JetPack that the base image of Jetsons belongs to (L4T r36); its libraries fit no other.
JETPACK = 6


class Distribution(Enum):
    """Release of Ubuntu, by its code name; the first suitable release is used."""

    BOOKWORM = "bookworm"
    NOBLE = "noble"
    JAMMY = "jammy"


@dataclass(frozen=True, slots=True, kw_only=True)
class BaseImage:
    """Base image of the hardware-dependent layer."""

    image: str  #: Name of the image, with a tag that is never moved to another image.
    distribution: Distribution  #: Distribution in the image.
    packages: tuple[str, ...]  #: Debian packages that the accelerator needs.
    environment: tuple[tuple[str, str], ...]  #: Variables that the accelerator's runtime reads.
    python: str  #: Version of the Python that runs sfglab, such as ``3.11``.
    python_packages: tuple[str, ...]  #: Debian packages that contain this Python.

    @property
    def interpreter(self) -> str:
        """Path of the Python from which the virtual environment is made."""
        return f"/usr/bin/python{self.python}"


_AMD64, _ARM64 = Architecture.AMD64, Architecture.ARM64
_BOOKWORM, _NOBLE, _JAMMY = Distribution.BOOKWORM, Distribution.NOBLE, Distribution.JAMMY

_ROS_RELEASE = {RosDistribution.HUMBLE: _JAMMY, RosDistribution.JAZZY: _NOBLE}

_PYTHON: dict[Distribution, tuple[str, tuple[str, ...]]] = {
    _BOOKWORM: ("3.11", ("python3", "python3-venv")),
    _NOBLE: ("3.12", ("python3", "python3-venv")),
    # 22.04's own is 3.10, which stays as it is for ROS 2; 3.11 comes from its section universe.
    _JAMMY: ("3.11", ("python3.11", "python3.11-venv")),
}

# A date in the tag, because makers move the plain ones with every repair.
_PLAIN = {
    _BOOKWORM: "docker.io/library/debian:bookworm-20250811-slim",
    _NOBLE: "docker.io/library/ubuntu:noble-20251013",
    _JAMMY: "docker.io/library/ubuntu:jammy-20251013",
}
_JETPACK = {_JAMMY: "nvcr.io/nvidia/l4t-jetpack:r36.4.0"}
_CUDA = {
    _NOBLE: "docker.io/nvidia/cuda:12.6.3-runtime-ubuntu24.04",
    _JAMMY: "docker.io/nvidia/cuda:12.6.3-runtime-ubuntu22.04",
}
_ROCM = {
    _NOBLE: "docker.io/rocm/dev-ubuntu-24.04:6.4.1",
    _JAMMY: "docker.io/rocm/dev-ubuntu-22.04:6.4.1",
}

_ANYWHERE = product((Accelerator.VAAPI, Accelerator.V4L2, Accelerator.NONE), (_AMD64, _ARM64))
_IMAGES: dict[tuple[Accelerator, Architecture], dict[Distribution, str]] = {
    (Accelerator.JETSON, _ARM64): _JETPACK,
    (Accelerator.CUDA, _AMD64): _CUDA,
    (Accelerator.ROCM, _AMD64): _ROCM,
    **dict.fromkeys(_ANYWHERE, _PLAIN),
}

_VAAPI = ("libva-drm2", "mesa-va-drivers", "vainfo")
_PACKAGES: dict[tuple[Accelerator, Architecture], tuple[str, ...]] = {
    (Accelerator.ROCM, _AMD64): _VAAPI,
    (Accelerator.VAAPI, _AMD64): ("intel-media-va-driver", *_VAAPI),
    (Accelerator.VAAPI, _ARM64): _VAAPI,
    (Accelerator.V4L2, _AMD64): ("v4l-utils",),
    (Accelerator.V4L2, _ARM64): ("v4l-utils",),
}

# The container runtime hides NVENC and NVDEC unless asked (NVIDIA Container Toolkit, "Driver Capabilities").
_NVIDIA = (
    ("NVIDIA_VISIBLE_DEVICES", "all"),
    ("NVIDIA_DRIVER_CAPABILITIES", "compute,utility,video"),
)
_ENVIRONMENT = {Accelerator.JETSON: _NVIDIA, Accelerator.CUDA: _NVIDIA}


def base_of(deployment: Deployment) -> BaseImage:
    """Return the base image of an agent's images, given its accelerator, processor and ROS 2 distribution.

    Raises:
        DeployError: There is no such base image.
    """
    accelerator, architecture = deployment.accelerator, deployment.host.architecture
    images = _IMAGES.get((accelerator, architecture))
    if images is None:
        allowed = ", ".join(known.value for given, known in _IMAGES if given is accelerator)
        raise DeployError(
            f"{deployment.host.place}.architecture: given {architecture.value!r} with accelerator "
            f"{accelerator.value!r}, allowed with this accelerator: {allowed}"
        )
    distribution = _distribution(deployment, tuple(images))
    python, python_packages = _PYTHON[distribution]
    return BaseImage(
        image=images[distribution],
        distribution=distribution,
        packages=_PACKAGES.get((accelerator, architecture), ()),
        environment=_ENVIRONMENT.get(accelerator, ()),
        python=python,
        python_packages=python_packages,
    )


def _distribution(deployment: Deployment, offered: tuple[Distribution, ...]) -> Distribution:
    ros = deployment.common.ros
    wanted = _ROS_RELEASE.get(ros)
    if wanted is None:
        return next(member for member in Distribution if member in offered)
    if wanted in offered:
        return wanted
    known = [
        RosDistribution.NONE,
        *(given for given, release in _ROS_RELEASE.items() if release in offered),
    ]
    allowed = ", ".join(member.value for member in known)
    raise DeployError(
        f"{deployment.host.place}: given accelerator {deployment.accelerator.value!r} in a fleet with ROS 2 "
        f"{ros.value!r} (Ubuntu {wanted.value}), allowed at deployment.ros with this accelerator: {allowed}"
    )
