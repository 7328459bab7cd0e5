"""Write the results of version 671791e4 as files: one side of `tools/compare.py`.

    python tools/compare_baseline.py FOLDER LOGS [SECTION ...]

It is run with the tree of that version first on the path and as the working directory. LOGS is the
folder of the committed logs that both sides read. Each section is a folder of files: JSON and CSV
that are compared value by value, and others byte by byte.
"""

from __future__ import annotations

import asyncio
import csv
import hashlib
import importlib
import json
import re
import shutil
import subprocess
import sys
import tempfile
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

SEEDED = {
    "naming": {"checks"},
    "routing": {"policy"},
    "discovery": {"simulated"},
    "balancing": {"Table 1", "caches", "Eq. 6"},
    "transmission": {"cell"},
    "cooperation": {"course", "drawn runs"},
    "phases": {"cell", "course"},
    "gateways": {"exploration", "mapping"},
    "transfer": {"law", "cycles", "model", "curves", "node mapping", "hardware"},
    "driving": {"lap", "chain", "drawn lap"},
    "mocap": {"trees", "faults", "offsets"},
    "planning": {"trajectories", "edits and faults", "example"},
    "visualisation": {"points"},
}
"""Sweeps and parts of each experiment that are exact or simulated from a seed."""
NODES = ("compensation", "gaussian_blur", "lane_planner", "polyfit", "lane_control")
TIMES = {
    "driving.chain": {f"{node}_ns" for node in NODES},
    "driving.lap": {
        f"{node}_s"
        for node in (
            *NODES,
            *("camera", "red_light_detection", "green_light_detection", "visual_odometry"),
        )
    },
    "planning.editing": {"took_us"},
    "transfer.placed": {"seconds"},
}
"""Columns of these tables that hold times measured on this machine."""
PLACES = {"design": "sfglab.lab.experiments.decode_once.analysis"}
"""Modules of functions that were moved since."""
MESSAGES = 200
RELEASE = re.compile(rb"[0-9a-f]{12,64}(?:-dirty)?|\d{4}-\d\d-\d\dT[\d:+]+")
"""Hashes, commits and times in the files of a release."""
COMMANDS = {
    "fleet-lint.txt": ["fleet", "lint", "data/fleets/lab.yaml"],
    "fleet-lint.json": ["fleet", "lint", "data/fleets/lab.yaml", "--json"],
    "dds-router.yaml": ["fleet", "router", "data/fleets/lab.yaml", "--agent", "go2"],
    "map.txt": ["map", "data/graphs/figure_8.yaml"],
    "map-size.txt": ["map", "data/graphs/driving.yaml", "--rule", "size"],
    **{
        f"qos-{kind}.txt": ["qos", "data/qos/paper_b.yaml", "--format", kind]
        for kind in ("table", "fastdds", "fastdds3", "cyclone", "ros2")
    },
    "qos-paper.txt": ["qos", "data/qos/paper_b.yaml", "--method", "printed"],
}
"""Commands whose output is compared, by the name of the file that holds it."""
FOLDERS = {
    "interfaces": ["interfaces"],
    "esslingen": ["deploy", "render", "data/fleets/esslingen.yaml", "-o"],
    **{
        f"go2-{base}": [
            *("deploy", "render", "data/fleets/esslingen.yaml", "--agent", "go2"),
            *("--accelerator", base, "-o"),
        ]
        for base in ("jetson", "cuda", "rocm", "vaapi", "v4l2", "none")
    },
}
"""Commands that fill a folder, whose path is their last word."""
ROUTER = "router: dds-router\n  router_image: ubuntu-ddsrouter:v3.5.0"
VARIANTS = {
    "ros-none": ("ros: humble", "ros: none"),
    "ros-jazzy": ("ros: humble", "ros: jazzy"),
    "dds-router": ("router: sfglab", ROUTER),
}
"""Fleets that are rendered as well: esslingen.yaml with one text in place of another."""


class Side:
    """The files that one version makes."""

    def __init__(self, folder: Path, logs: Path) -> None:
        self.folder = folder
        self.logs = logs

    def write_json(self, name: str, value: Any) -> None:
        """Write a value; NaN and infinity as Python's JSON has them."""
        file = self._file(f"{name}.json")
        file.write_text(json.dumps(value, indent=1, sort_keys=True, default=str) + "\n", "utf-8")

    def write_rows(self, name: str, columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
        """Write a table; floats with all their digits."""
        with self._file(f"{name}.csv").open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(columns)
            writer.writerows([repr(cell) for cell in row] for row in rows)

    def write_bytes(self, name: str, content: bytes) -> None:
        """Write a file as it is."""
        self._file(name).write_bytes(content)

    def _file(self, name: str) -> Path:
        file = self.folder / name
        file.parent.mkdir(parents=True, exist_ok=True)
        return file


def claims(side: Side, name: str) -> None:
    """Judge the claims of an experiment from its committed log, and draw its figures."""
    from sfglab.fields import to_json
    from sfglab.lab.claims import entry_for, load_claims
    from sfglab.lab.experiments import experiment
    from sfglab.lab.figures import save_figure

    exp = experiment(name)
    run = exp.load(side.logs / f"{name}.mcap")
    stated = {claim.id: claim for claim in load_claims(Path("data/claims.yaml"))}
    for claim, measured in exp.measure(run).items():
        entry = entry_for(stated[claim], measured)
        value = {"verdict": entry.verdict.value, "reason": entry.reason, **to_json(measured)}
        side.write_json(f"claims/{claim} by {name}", value)
    for figure, (drawn, shown) in exp.figures(run).items():
        side.write_json(f"figures/{figure}", json.loads(json.dumps(to_json(shown), default=str)))
        with tempfile.TemporaryDirectory() as folder:
            svg = save_figure(drawn, Path(folder, figure), {})[0].read_bytes()
        side.write_bytes(f"figures/{figure}.sha256", hashlib.sha256(svg).hexdigest().encode())


def rows(side: Side, name: str) -> None:
    """Run the seeded parts of an experiment in the profile smoke."""
    from sfglab.lab.bench import Options
    from sfglab.lab.experiments import experiment

    exp = experiment(name)
    options = Options(only=frozenset(SEEDED[name]), separate=False)
    with tempfile.TemporaryDirectory() as folder:
        run = asyncio.run(exp.run("smoke", path=Path(folder) / "a.mcap", options=options))
        for table in exp.tables:
            frame = run[table]
            if len(frame):
                frame = frame.drop(columns=TIMES.get(f"{name}.{table}", set()), errors="ignore")
                content = frame.astype(object).itertuples(index=False)
                side.write_rows(f"rows/{name}.{table}", list(frame.columns), content)


def messages(side: Side, _: str) -> None:
    """Serialise random values of every message type."""
    from random_messages import random_message

    from sfglab.messages import serialize
    from sfglab.messages.store import type_store

    for name in sorted(type_store().fielddefs):
        rng = np.random.default_rng(7)
        digest = hashlib.sha256()
        with suppress(KeyError):
            for _ in range(MESSAGES):
                digest.update(serialize(random_message(rng, name)))
            side.write_bytes(f"messages/{name.replace('/', '.')}", digest.hexdigest().encode())


def codecs(side: Side, _: str) -> None:
    """Encode a depth image and a video."""
    from sfglab.codecs import TABLE_2, H264Encoder, encode_depth

    rng = np.random.default_rng(7)
    depth_mm = np.cumsum(rng.integers(-3, 4, (360, 640)), axis=1).astype(np.uint16)
    form, data = encode_depth(depth_mm, codec="rvl")
    side.write_bytes("codecs/rvl", str(form).encode() + data)
    encoder = H264Encoder(replace(TABLE_2, encoder="libx264"))
    image = rng.integers(0, 256, (360, 640, 3), np.uint8)
    for number in range(5):
        (frame,) = encoder.encode(np.roll(image, number, axis=1))
        side.write_bytes(f"codecs/h264-{number}", bytes(frame.data))


def commands(side: Side, _: str) -> None:
    """Run commands, and keep what they print or write."""
    for name, words in COMMANDS.items():
        side.write_bytes(f"commands/{name}", _sfglab(*words))
    folders = dict(FOLDERS)
    for name, (given, instead) in VARIANTS.items():
        fleet = side.folder / f"{name}.yaml"
        text = Path("data/fleets/esslingen.yaml").read_text("utf-8")
        assert given in text
        fleet.write_text(text.replace(given, instead), "utf-8")
        folders[f"esslingen-{name}"] = ["deploy", "render", str(fleet), "-o"]
    for name, words in folders.items():
        folder = side.folder / "folders" / name
        shutil.rmtree(folder, ignore_errors=True)
        folder.parent.mkdir(parents=True, exist_ok=True)
        _sfglab(*words, str(folder))
        _normalise(folder)
    mapped = side.folder / "commands" / "map-out.yaml"
    _sfglab("map", "data/graphs/figure_8.yaml", "--out", str(mapped))


def _normalise(folder: Path) -> None:
    """Take what names the release away: the package itself, its hashes, and times."""
    for file in [path for path in folder.rglob("*") if path.is_file()]:
        if file.suffix == ".whl":
            file.unlink()
        else:
            file.write_bytes(RELEASE.sub(b"...", file.read_bytes()))


def _sfglab(*words: str) -> bytes:
    argv = [sys.executable, "-P", "-m", "sfglab", *words]
    done = subprocess.run(argv, capture_output=True, check=False)
    return done.stdout + f"status {done.returncode}\n".encode()


def rules(side: Side, _: str) -> None:
    """Write transition tables, equations, and what a cache decides."""
    from sfglab.arp.cache import LocalCache
    from sfglab.fleet.discovery.lifecycle import TRANSITIONS

    design = importlib.import_module(PLACES["design"]).design
    side.write_json("rules/discovery", {str(key): str(value) for key, value in TRANSITIONS.items()})
    terms = {f"{m} {n}": design(m, n) for m in ("standard", "network", "dds") for n in range(1, 11)}
    side.write_json("rules/cost", terms)
    cache = LocalCache(max_silence_ns=7)
    words = np.random.default_rng(7).choice(["a", "b", "c"], MESSAGES).tolist()
    decisions = [cache.offer("topic", word, now_ns=at_ns).value for at_ns, word in enumerate(words)]
    side.write_json("rules/cache", decisions)


def logs(side: Side, _: str) -> None:
    """Read every message of the committed logs."""
    from sfglab.record import LogReader

    for log in sorted(side.logs.glob("*.mcap")):
        topics: dict[str, Any] = {}
        with LogReader(log) as reader:
            for entry in reader.messages():
                topic = topics.setdefault(entry.topic, [0, hashlib.sha256()])
                topic[0] += 1
                topic[1].update(entry.cdr)
        found = {name: [count, digest.hexdigest()] for name, (count, digest) in topics.items()}
        side.write_json(f"logs/{log.stem}", found)


def sections() -> dict[str, Callable[[Side, str], None]]:
    """Return what is computed, by name; names with a colon end in an experiment."""
    from sfglab.lab.experiments import EXPERIMENTS

    whole = {f.__name__: f for f in (messages, codecs, commands, rules, logs)}
    judged = {f"claims:{name}": claims for name in EXPERIMENTS}
    seeded = {f"rows:{name}": rows for name in SEEDED}
    return {**judged, **seeded, **whole}


def main(arguments: Sequence[str]) -> None:
    """Compute the sections that are named; all without a name."""
    folder, logs_folder, *names = arguments
    side = Side(Path(folder).resolve(), Path(logs_folder).resolve())
    every = sections()
    for name in names or every:
        print(name, flush=True)
        every[name](side, name.partition(":")[2])


if __name__ == "__main__":
    main(sys.argv[1:])
