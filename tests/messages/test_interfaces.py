"""Types of users, registered by files and at the command line, and our own as a package for ROS 2."""

import logging
import os
import re
import subprocess
import sys
from importlib import resources

import pytest
from commands import called

import sfglab
from sfglab import messages
from sfglab.bus.dds.forwarder import _opaque
from sfglab.errors import SfglabError
from sfglab.messages import MessageError, message_type, message_types, register_interfaces
from sfglab.messages.store import INTERFACES_VARIABLE

WIDE = "user_msgs_a/msg/Wide"


def written(folder, texts):
    for name, text in texts.items():
        file = folder / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    return folder


@pytest.fixture
def workspace(tmp_path):
    """Two packages that use each other's types, in a folder whose name is not the package's."""
    return written(
        tmp_path,
        {
            "a/package.xml": "<package><name> user_msgs_a </name></package>",
            "a/msg/Grip.msg": "float32 force\nuser_msgs_b/Finger[] fingers\n",
            "a/msg/Wide.msg": "wstring text\n",
            "a/srv/Ask.srv": "Wide what\n---\nbool done\n",
            "user_msgs_b/msg/Finger.msg": "Side side\n",
            "user_msgs_b/msg/Side.msg": "uint8 LEFT=1\nuint8 side\n",
            "user_msgs_b/srv/Open.srv": "user_msgs_a/Grip grip\n---\n",
            "user_msgs_b/action/Grasp.action": "user_msgs_b/Finger finger\n---\n---\nfloat32 force\n",
        },
    )


def test_a_folder_of_packages_is_registered_without_what_we_do_not_have(workspace, caplog):
    with pytest.raises(
        MessageError, match=r"no type user_msgs_b/msg/Finger; register its package first"
    ):
        register_interfaces(workspace / "a" / "msg" / "Grip.msg")
    with pytest.raises(MessageError, match=r"Wide.text: given wstring, allowed: string"):
        register_interfaces(workspace / "a" / "msg" / "Wide.msg")
    with caplog.at_level(logging.WARNING):
        names = register_interfaces(workspace)
    assert {"user_msgs_a/msg/Grip", "user_msgs_b/msg/Side", "user_msgs_b/srv/Open_Request"} <= set(
        names
    )
    assert message_type("user_msgs_b/msg/Side").LEFT == 1
    assert (
        messages.service_type("user_msgs_b/srv/Open").request.__msgtype__
        == "user_msgs_b/srv/Open_Request"
    )
    assert (
        messages.action_type("user_msgs_b/action/Grasp").goal.__msgtype__
        == "user_msgs_b/action/Grasp_Goal"
    )
    assert sorted(record.args[0].name for record in caplog.records) == ["Ask.srv", "Wide.msg"]
    assert not {WIDE, "user_msgs_a/srv/Ask_Request", "user_msgs_a/srv/Ask_Response"} & set(
        message_types()
    )


def test_types_given_to_a_command_are_known_to_it_and_to_the_processes_it_starts(
    tmp_path, monkeypatch
):
    monkeypatch.setenv(INTERFACES_VARIABLE, "")
    names = ["user_msgs_c/msg/One", "user_msgs_d/msg/Two"]
    texts = {
        "user_msgs_c/msg/One.msg": "int32 x\n",
        "user_msgs_d/msg/Two.msg": "user_msgs_c/One one\n",
    }
    first, second = (written(tmp_path, texts) / name.partition("/")[0] for name in names)
    both = ["--interfaces", str(first), "--interfaces", str(second)]
    with pytest.raises(SfglabError, match="domain on both sides"):
        called("router", "--domain", "0", *both)
    assert set(names) <= set(message_types())
    code = f"from sfglab.messages import message_type; print(*map(message_type, {names}))"
    child = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert child.stdout.count("user_msgs_") == 2
    assert os.environ[INTERFACES_VARIABLE].split(os.pathsep) == [str(first), str(second)]


@pytest.mark.parametrize("command", [["agent", "up"], ["router"], ["view"]])
def test_commands_that_meet_types_of_users_say_what_is_wrong_with_them(tmp_path, command):
    with pytest.raises(SfglabError) as refused:
        called(*command, "--interfaces", str(tmp_path))
    said = "no .msg, .srv or .action file is there; give such a file or the folder of a package"
    assert str(refused.value) == f"{tmp_path}: {said}"


def test_a_router_warns_once_of_an_interface_that_it_does_not_know_and_names_the_cure(caplog):
    parts = [
        "srv/Wave_Request",
        "srv/Wave_Response",
        "action/Go_SendGoal_Request",
        "action/Go_FeedbackMessage",
    ]
    with caplog.at_level(logging.WARNING):
        for part in parts * 2:
            _opaque(f"nobodys_msgs/{part}")
    said = [record.message for record in caplog.records]
    assert [text.split()[2] for text in said] == ["nobodys_msgs/srv/Wave", "nobodys_msgs/action/Go"]
    assert all("--interfaces" in text for text in said)


def test_our_interfaces_are_written_as_a_package_of_ament(tmp_path):
    package = tmp_path / "sfglab_interfaces"
    assert called("interfaces", str(tmp_path)) == f"{package}\n"
    ours = resources.files("sfglab.messages") / "interfaces" / "sfglab_interfaces"
    kinds = [ours / kind for kind in ("msg", "srv", "action")]
    files = {
        f"{kind.name}/{file.name}": file.read_text() for kind in kinds for file in kind.iterdir()
    }
    assert files == {name: (package / name).read_text() for name in files}
    assert set(register_interfaces(package)) <= set(message_types())
    manifest = (package / "package.xml").read_text()
    used = {
        name for text in files.values() for name in re.findall(r"^([a-z]\w*)/", text, re.MULTILINE)
    }
    depends = set(re.findall("<depend>(.*)</depend>", manifest))
    assert depends == used - {"sfglab_interfaces"} | {"action_msgs"}
    assert f"<version>{sfglab.__version__}</version>" in manifest
    cmake = (package / "CMakeLists.txt").read_text()
    assert all(f'  "{name}"\n' in cmake for name in files)
    assert all(f"find_package({name} REQUIRED)" in cmake for name in depends)
    (tmp_path / "file").touch()
    with pytest.raises(SfglabError, match="not a directory"):
        called("interfaces", str(tmp_path / "file"))
