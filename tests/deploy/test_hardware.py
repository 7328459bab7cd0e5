"""Detection on made-up roots: accelerators and codecs, with reasons, and no file that misleads it."""

import os
import re
from pathlib import Path

import pytest
from example_machines import EXAMPLES, write_example

from sfglab.codecs.probe import DECODERS, ENCODERS, probe_encoder
from sfglab.deploy.errors import DeployError
from sfglab.deploy.hardware import (
    CodecRole,
    codecs_found,
    detect,
    expected_codecs,
    render_machine,
)
from sfglab.deploy.machine_files import MachineFiles
from sfglab.fleet.fleet_file import Accelerator

MACHINES = {
    "jetson_orin_nx": "jetson",
    "jetson_xavier_nx": "jetson",
    "workstation_rtx": "cuda",
    "nvidia_without_driver": "none",
    "desktop_rocm": "rocm",
    "steam_deck": "vaapi",
    "laptop_intel": "vaapi",
    "raspberry_pi_5": "v4l2",
    "raspberry_pi_4": "v4l2",
    "wsl2": "cuda",
    "container": "none",
    "riscv_board": "none",
}


@pytest.fixture
def machine(tmp_path):
    """Detection on an example, with files added, changed or (None) left out."""
    return lambda name, **changes: detect(write_example(name, tmp_path / "root", **changes))


def check_honest(machine):
    """Check that the chosen accelerator is there with all its devices."""
    chosen = machine.evidence[machine.accelerator]
    assert chosen.found
    assert machine.devices == chosen.devices
    files = MachineFiles(Path(machine.root))
    assert all(files.has(path) for path in machine.devices)


@pytest.mark.parametrize(("name", "accelerator"), MACHINES.items())
def test_each_machine_gets_its_accelerator_also_if_any_one_file_is_a_pipe_folder_or_loop(
    name, accelerator, machine, tmp_path
):
    found = machine(name)
    assert found.accelerator.value == accelerator
    check_honest(found)
    assert (found.model + found.operating_system).isprintable()
    makers = (os.mkfifo, os.mkdir, lambda path: path.symlink_to(path.name))
    for number, path in enumerate(sorted(EXAMPLES[name])):
        place = tmp_path / "root" / path
        place.unlink()
        check_honest(detect(tmp_path / "root"))
        makers[number % 3](place)  # opening a pipe would block
        check_honest(detect(tmp_path / "root"))


def l4t(text):
    return {"etc/nv_tegra_release": text}


QCOM = {"dev/video1": "", "sys/class/video4linux/video1/name": "qcom-venus-encoder\n"}
NO_TEGRA_NODES = {path: None for path in EXAMPLES["jetson_orin_nx"] if path.startswith("dev/nv")}
NO_NAME = "an unknown release of L4T"


@pytest.mark.parametrize(
    ("name", "changes", "asked", "says", "chosen"),
    [
        # The JetPack that NVIDIA's archive names.
        ("jetson_orin_nx", l4t("# R28 (release), REVISION: 2.1"), "jetson", "JetPack 3", "jetson"),
        ("jetson_orin_nx", l4t("# R77 (release), REVISION: 1.0"), "jetson", "unknown", "jetson"),
        ("jetson_orin_nx", l4t(None), "jetson", NO_NAME, "jetson"),
        ("jetson_orin_nx", NO_TEGRA_NODES, "jetson", "without NVIDIA's runtime", "none"),
        ("wsl2", {"usr/lib/wsl/lib/libcuda.so.1.1": None}, "cuda", "not NVIDIA's", "none"),
        ("jetson_orin_nx", {}, "cuda", "display", "jetson"),
        ("workstation_rtx", {}, "cuda", "driver 565.57.01 with 1 card", "cuda"),
        ("workstation_rtx", {"dev/nvidia0": None}, "cuda", "without /dev/nvidia0", "vaapi"),
        ("steam_deck", {}, "rocm", "gfx1033 is not on AMD's list", "vaapi"),
        ("desktop_rocm", {"dev/dri/renderD128": None}, "rocm", "render node is missing", "none"),
        ("raspberry_pi_5", {}, "v4l2", "HEVC decoder only: the processor encodes", "v4l2"),
        ("riscv_board", QCOM, "v4l2", "unknown formats (qcom-venus-encoder)", "v4l2"),
        ("container", {}, "none", "container", "none"),
    ],
)
def test_the_reason_says_what_is_there_and_what_is_missing(
    machine, name, changes, asked, says, chosen
):
    found = machine(name, **changes)
    assert says in found.evidence[Accelerator(asked)].reason
    assert found.accelerator.value == chosen


def test_a_root_that_is_no_folder_is_refused():
    for place in ("/nowhere", __file__, "x" * 300):
        with pytest.raises(DeployError, match=r"root: given .*, allowed: an existing folder"):
            detect(Path(place))


@pytest.mark.parametrize("target", ["{outside}", "../../outside", "/../outside", "/outside"])
def test_no_link_leads_out_of_the_root(machine, tmp_path, target):
    outside = tmp_path / "outside"
    outside.write_text("PRETTY_NAME=leaked\n", encoding="utf-8")
    found = machine("riscv_board", **{"etc/os-release": f"-> {target.format(outside=outside)}"})
    assert found.operating_system == "unknown"


ENCODER, DECODER = CodecRole.ENCODER, CodecRole.DECODER
TRIED = [(name, ENCODER) for name in ENCODERS] + [(name, DECODER) for name in DECODERS]
NANO = {"sys/firmware/devicetree/base/model": "NVIDIA Jetson Orin Nano Developer Kit\0"}


def expected(machine):
    return {(codec.name, codec.role) for codec in expected_codecs(machine)}


@pytest.mark.parametrize(
    ("name", "encoders", "decoders", "changes"),
    [
        ("jetson_orin_nx", "h264_nvmpi", "h264_nvmpi", {}),
        ("jetson_orin_nx", "", "h264_nvmpi", NANO),
        ("workstation_rtx", "h264_nvenc", "h264_cuvid", {}),
        ("laptop_intel", "h264_vaapi h264_qsv", "h264_qsv", {}),
        ("raspberry_pi_4", "h264_v4l2m2m", "h264_v4l2m2m", {}),
        ("raspberry_pi_5", "", "", {}),
    ],
)
def test_each_machine_has_its_own_codecs_and_the_processor_s(
    name, encoders, decoders, changes, machine
):
    codecs = {(codec, ENCODER) for codec in f"{encoders} libx264".split()}
    codecs |= {(codec, DECODER) for codec in f"{decoders} h264".split()}
    assert expected(machine(name, **changes)) == codecs
    assert codecs <= set(TRIED)


def test_all_codecs_are_tried_here_and_reported_beside_those_of_the_machine(machine):
    found = machine("raspberry_pi_4")
    rows = {(row.name, row.role): row for row in codecs_found(found)}
    assert list(rows) == TRIED
    assert {key for key, row in rows.items() if row.expected} == expected(found)
    assert rows["h264_nvenc", ENCODER].why == "not expected on this machine"
    software = rows["libx264", ENCODER]
    assert (software.works, software.tried) == (True, probe_encoder("libx264").reason)
    report = render_machine(found, tuple(rows.values()))
    assert re.search("^  libx264 +encoder +yes +yes ", report, re.MULTILINE)


def test_a_report_has_every_accelerator_with_the_reason_and_the_devices_for_a_container(machine):
    text = render_machine(machine("jetson_orin_nx"))
    lines = text.splitlines()
    assert set(lines) >= {
        "Model:            NVIDIA Jetson Orin NX Engineering Reference Developer Kit",
        "Operating system: Ubuntu 22.04.5 LTS",
        "JetPack:          6",
        "Accelerator:      jetson",
        "* jetson  found: a Jetson with L4T 36.4.3, JetPack 6",
        "  cuda    not found: a Tegra: its /dev/nvidia* belong to the display",
    }
    order = re.findall(r"^..(\w+) +(?:not )?found: ", text, re.MULTILINE)
    assert order == ["jetson", "cuda", "rocm", "vaapi", "v4l2", "none"]
    devices = next(line for line in lines if line.startswith("Devices: "))
    assert "/dev/nvmap" in devices
    assert "/dev/video0" not in devices
    assert "PyAV" not in text
