"""Package of our own interfaces as ROS 2 builds it: definitions, `package.xml`, `CMakeLists.txt`.

Knows ament's files. Refuses to know how they are built: that is colcon's.
"""

from __future__ import annotations

import re
from importlib import resources
from typing import TYPE_CHECKING

from sfglab import __version__

if TYPE_CHECKING:
    from pathlib import Path

PACKAGE = "sfglab_interfaces"
"""The package of the types that sfglab defines itself."""
_USED = re.compile(r"^([a-z]\w*)/\w+", re.MULTILINE)
_XML = """\
<?xml version="1.0"?>
<package format="3">
  <name>{package}</name>
  <version>{version}</version>
  <description>What the components of sfglab say to each other and to whoever asks.</description>
  <maintainer email="sfglab@example.invalid">the authors of sfglab</maintainer>
  <license>Apache-2.0</license>
  <buildtool_depend>ament_cmake</buildtool_depend>
  <buildtool_depend>rosidl_default_generators</buildtool_depend>
{depends}
  <exec_depend>rosidl_default_runtime</exec_depend>
  <member_of_group>rosidl_interface_packages</member_of_group>
  <export><build_type>ament_cmake</build_type></export>
</package>
"""
_CMAKE = """\
cmake_minimum_required(VERSION 3.8)
project({package})
find_package(ament_cmake REQUIRED)
find_package(rosidl_default_generators REQUIRED)
{finds}
rosidl_generate_interfaces(${{PROJECT_NAME}}
{files}
  DEPENDENCIES {depends})
ament_export_dependencies(rosidl_default_runtime)
ament_package()
"""


def write_package(folder: Path) -> Path:
    """Write the ament package of our interfaces into a workspace's folder, and return the package's.

    What is there under the same names is replaced. `colcon build` makes types of it for every ROS 2 from
    Humble on.
    """
    package = folder / PACKAGE
    texts = {
        f"{kind.name}/{file.name}": file.read_text("utf-8")
        for kind in (resources.files("sfglab.messages") / "interfaces" / PACKAGE).iterdir()
        for file in kind.iterdir()
    }
    used = {name for text in texts.values() for name in _USED.findall(text)}
    depends = sorted((used | {"action_msgs"}) - {PACKAGE})  # what carries an action's parts is of that one
    files = sorted(texts)
    xml = _XML.format(
        package=PACKAGE,
        version=__version__,
        depends="\n".join(f"  <depend>{name}</depend>" for name in depends),
    )
    cmake = _CMAKE.format(
        package=PACKAGE,
        finds="\n".join(f"find_package({name} REQUIRED)" for name in depends),
        files="\n".join(f'  "{name}"' for name in files),
        depends=" ".join(depends),
    )
    for name, text in {**texts, "package.xml": xml, "CMakeLists.txt": cmake}.items():
        file = package / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, "utf-8")
    return package
