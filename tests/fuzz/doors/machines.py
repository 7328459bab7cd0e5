"""Answers of machines that are deployed to."""

import gzip
import os
import tarfile
from pathlib import Path

from doors import Door
from sfglab.deploy.bundle import Bundle, pack, unpack
from sfglab.deploy.errors import DeployError
from sfglab.deploy.files import BundleFile
from sfglab.deploy.rollout import plan_changes
from sfglab.deploy.transport import Transport, accelerator_of

MEMBERS = {"manifest.json": b'{"tag": "a", "files": {"b": {"sha256": "0"}}}', "b": b"x"}
MEMBERS = {name: BundleFile(data=data) for name, data in MEMBERS.items()}
BUNDLE = Bundle(agent="a", tag="t", image="i", members=MEMBERS)
FACTS = b"/dev/dri/card0\n/etc/os-release SUQ9YQ==\n/proc/device-tree/model YQ==\n"
SPARSE = tarfile.TarInfo("b")
SPARSE.size = 2**33
BENT = tuple(tarfile.TarInfo(path).tobuf() for path in ("../b", "/b", ".//b"))


class Answering(Transport):
    """A machine with a given answer."""

    def run(self, _script, **_):
        return self.client


def planned(data):
    """Plan with the files of an archive, all of which are below its folder."""
    files = unpack(data)
    for path in files:
        assert os.path.normpath(Path("/folder", path)).startswith("/folder")
    return plan_changes(BUNDLE, files)


DOORS = {
    "archive": Door(planned, DeployError, (pack(BUNDLE),)),
    "machine": Door(
        lambda d: accelerator_of(Answering(address="m", client=d)), DeployError, (FACTS,)
    ),
}
ATTACKS = [
    *(
        ("archive", data)
        for data in (SPARSE.tobuf(), *BENT, b"x" * 600, gzip.compress(bytes(2**28)))
    ),
    *(
        ("machine", d)
        for d in (
            b"/etc/os-release a\n",
            b"/a\0b YQ==\n",
            b"/etc\n/etc/os-release\n",
            b"/" + b"a" * 300,
        )
    ),
]
