"""Documents that people write: ours, and those of other routers."""

from doors import ROOT, Door, text
from sfglab.deploy.routers.dds_router_check import check_dds_router
from sfglab.deploy.shapes import read_json5
from sfglab.documents import DocumentError
from sfglab.errors import SfglabError
from sfglab.fleet.fleet_file import read_fleet
from sfglab.spatial.scene.files import read_scene
from sfglab.spatial.trajectory.exchange import COLUMNS, trajectory_from_csv

JSON5 = b"// x\n{mode: 'peer', plugins: {a: {domain: 1, allow: {names: [\"/a/.*\"], }, },},}\n"
ROUTER = b"version: v5.0\nparticipants:\n  - name: a\n    kind: local\n    domain: 1\n"
CSV = f"{','.join(COLUMNS)}\n0.0,1,2,3,0,0,0,1\n".encode()
FLEET, SCENE = (
    (ROOT / f"data/{name}.yaml").read_bytes()[:1500] for name in ("fleets/lab", "scenes/hall")
)
YAML = (
    "!!int ''",
    "!!bool maybe",
    "!!timestamp x",
    '"\\U00110000"',
    "0x" + "f" * 5000,
    ":".join("1" * 10**5),
)
DOORS = {
    "fleet": Door(text(read_fleet), DocumentError, (FLEET,)),
    "scene": Door(text(read_scene), SfglabError, (SCENE,)),
    "trajectory": Door(text(trajectory_from_csv), SfglabError, (CSV,)),
    "json5": Door(text(lambda given: read_json5(given, "a.json5")), DocumentError, (JSON5,)),
    "dds router": Door(text(check_dds_router), SfglabError, (ROUTER,)),
}
ATTACKS = [
    *(("fleet", f"fleet: {value}\nagents: {value}\n".encode()) for value in YAML),
    *(
        ("json5", data)
        for data in (
            b"{a: 1," + b"/* x */ " * 40 + b"3}",
            b"/*" * 2**15,
            b'"\\' * 2**15,
            b"1" * 2**16,
        )
    ),
    ("trajectory", CSV.replace(b"0.0", b"1e99999999")),
    ("trajectory", CSV.replace(b"x_m", b"\r_m")),
]
