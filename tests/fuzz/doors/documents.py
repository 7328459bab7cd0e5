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
DOORS = {
    "fleet": Door(text(read_fleet), DocumentError, (FLEET,)),
    "scene": Door(text(read_scene), SfglabError, (SCENE,)),
}
ATTACKS = [
    *(("fleet", f"fleet: {value}\nagents: {value}\n".encode()) for value in YAML),
]
