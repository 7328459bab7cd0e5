"""Documents that people write."""

from doors import ROOT, Door, text
from sfglab.documents import DocumentError
from sfglab.errors import SfglabError
from sfglab.fleet.fleet_file import read_fleet
from sfglab.spatial.scene.files import read_scene

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
# A key that stands for ten lists, each of which stands for ten.
LISTS = [f"&a{n} [{', '.join([f'*a{n - 1}'] * 10)}]" for n in range(1, 9)]
BOMB = "\n".join(["? [&a0 [x],", *(f"{one}," for one in LISTS), "]", ": 1\n"])
DOORS = {
    "fleet": Door(text(read_fleet), DocumentError, (FLEET,)),
    "scene": Door(text(read_scene), SfglabError, (SCENE,)),
}
ATTACKS = [
    *(("fleet", f"fleet: {value}\nagents: {value}\n".encode()) for value in YAML),
    ("fleet", BOMB.encode()),
]
