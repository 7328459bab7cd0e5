"""What a colcon workspace needs from ROS 2: its set-up, its Python and the environment of its nodes."""

from __future__ import annotations

from sfglab.fleet.fleet_file import RosDistribution

PYTHON = {RosDistribution.HUMBLE: "3.10", RosDistribution.JAZZY: "3.12"}
"""Python of the Ubuntu that a distribution is made for (REP 2000)."""

INTERPRETER = "/opt/venv/bin/python"
"""Python that has sfglab in the images; nodes of a distribution run on the system's."""

ENVIRONMENT_FILE = "build/ros.env"
"""Where the environment of the workspace's nodes is kept for debuggers, which source no shell files."""

_KEPT = "^(AMENT_|CMAKE_PREFIX_PATH=|COLCON_|LD_LIBRARY_PATH=|PATH=|PYTHONPATH=|ROS_)"


def sourced(ros: RosDistribution, command: str) -> str:
    """Return a command line for Bash that runs a command in the distribution's environment."""
    return f"source /opt/ros/{ros.value}/setup.bash && {command}"


def build_command(ros: RosDistribution) -> str:
    """Return how the workspace is built: with symbols, and with compile commands for code completion.

    colcon collects the compile commands of all packages in ``build/compile_commands.json`` (colcon-cmake).
    """
    flags = "-DCMAKE_BUILD_TYPE=Debug -DCMAKE_EXPORT_COMPILE_COMMANDS=ON"
    return sourced(ros, f"colcon build --symlink-install --cmake-args {flags}")


def environment_command(ros: RosDistribution) -> str:
    """Return how `ENVIRONMENT_FILE` is written."""
    overlay = "{ [ ! -f install/setup.bash ] || source install/setup.bash; }"
    return sourced(ros, f"{overlay} && mkdir -p build && printenv | grep -E '{_KEPT}' > {ENVIRONMENT_FILE}")
