"""Detection on made-up roots: accelerators and codecs, with reasons, and no file that misleads it."""

import os
import platform
import tempfile
from dataclasses import replace
from pathlib import Path

import pytest
from example_machines import ELF_MACHINES, EXAMPLES, elf_header, write_example
from hypothesis import given, settings
from hypothesis import strategies as st

from sfglab.codecs.probe import DECODERS, ENCODERS, probe_encoder
from sfglab.deploy.errors import DeployError
from sfglab.deploy.hardware import (
    CodecRole,
    DeviceGroup,
    codecs_found,
    detect,
    expected_codecs,
    find_architecture,
    gfx_name,
    render_machine,
)
from sfglab.deploy.machine_files import MachineFiles
from sfglab.fleet.fleet_file import Accelerator, Architecture

ORDER = [Accelerator(name) for name in ("jetson", "cuda", "rocm", "vaapi", "v4l2", "none")]
names = pytest.mark.parametrize("name", EXAMPLES)


@pytest.fixture
def machine(tmp_path):
    """Detection on an example, with files added, changed or (None) removed."""

    def build(name, **changes):
        files = {**EXAMPLES[name].files, **changes}
        files = {path: text for path, text in files.items() if text is not None}
        return detect(write_example(replace(EXAMPLES[name], files=files), tmp_path / "root"))

    return build


def check_honest(machine):
    """The first that is found is chosen, and all devices are there."""
    files = MachineFiles(Path(machine.root))
    assert [item.accelerator for item in machine.evidence] == ORDER
    chosen = next(item for item in machine.evidence if item.found)
    assert (machine.accelerator, machine.devices) == (chosen.accelerator, chosen.devices)
    assert all(files.has(path) for path in machine.devices)
    for item in machine.evidence:
        assert item.reason
        assert item.found or not (item.devices or item.codecs)


@names
def test_each_gets_its_accelerator_and_without_any_one_file_none_that_is_not_there(
    name, machine, tmp_path
):
    found = machine(name)
    assert found.accelerator is EXAMPLES[name].expected
    check_honest(found)
    root = tmp_path / "root"
    for path in sorted(path for path in root.rglob("*") if path.is_file() or path.is_symlink()):
        away = tmp_path / "away"
        path.rename(away)
        check_honest(detect(root))
        away.rename(path)


@settings(max_examples=40, deadline=None)
@given(st.sampled_from(sorted(EXAMPLES)), st.binary(max_size=64), st.data())
def test_any_mixture_of_two_machines_files_and_junk_is_judged_by_what_is_there(name, junk, data):
    other = data.draw(st.sampled_from(sorted(EXAMPLES)))
    pool = {**EXAMPLES[other].files, **EXAMPLES[name].files}
    kept = data.draw(st.sets(st.sampled_from(sorted(pool)), min_size=1))
    links = {path: target for path, target in EXAMPLES[name].links.items() if path not in kept}
    example = replace(EXAMPLES[name], files={path: pool[path] for path in kept}, links=links)
    with tempfile.TemporaryDirectory() as folder:
        root = write_example(example, Path(folder))
        for path in data.draw(st.sets(st.sampled_from(sorted(kept)))):
            (root / path).write_bytes(junk)
        found = detect(root)
        check_honest(found)
        assert (found.model + found.operating_system).isprintable()


@names
def test_pipes_folders_and_loops_in_place_of_files_are_read_as_absent_and_never_opened(
    name, machine, tmp_path
):
    machine(name)
    files = {path: tmp_path / "root" / path for path in sorted(EXAMPLES[name].files)}
    for path, place in files.items():
        if path.startswith("dev/"):
            place.unlink()
            os.mkfifo(place)  # opening it would block
    assert detect(tmp_path / "root").accelerator is EXAMPLES[name].expected
    makers = (os.mkfifo, os.mkdir, lambda path: path.symlink_to(path.name))
    for number, place in enumerate(files.values()):
        place.unlink()
        makers[number % 3](place)
    check_honest(detect(tmp_path / "root"))


def test_an_orin_nx_tells_its_jetpack_and_the_nodes_and_groups_a_container_needs(machine):
    found = machine("jetson_orin_nx")
    assert found.architecture is Architecture.ARM64
    assert found.jetpack == 6
    assert found.model == "NVIDIA Jetson Orin NX Engineering Reference Developer Kit"
    assert found.operating_system == "Ubuntu 22.04.5 LTS"
    assert {"/dev/nvmap", "/dev/nvgpu/igpu0/ctrl", "/dev/v4l2-nvenc"} < set(found.devices)
    assert "/dev/video0" not in found.devices
    assert found.groups == (DeviceGroup(name="render", gid=992), DeviceGroup(name="video", gid=44))


@pytest.mark.parametrize(
    ("release", "jetpack", "says"),
    [
        ("# R28 (release), REVISION: 2.1, GCID: 1", 3, "L4T 28.2.1, JetPack 3"),
        ("# R38 (release), REVISION: 2.1,", 7, "L4T 38.2.1, JetPack 7"),
        ("# R77 (release), REVISION: 1.0", None, "L4T 77.1.0, JetPack unknown"),
        ("tegra", None, "an unknown release of L4T"),
        (None, None, "an unknown release of L4T"),
    ],
)
def test_l4t_releases_give_the_jetpack_that_nvidia_s_archive_names(machine, release, jetpack, says):
    found = machine("jetson_orin_nx", **{"etc/nv_tegra_release": release})
    assert found.accelerator is Accelerator.JETSON
    assert found.jetpack == jetpack
    assert says in found.evidence_of(Accelerator.JETSON).reason


def test_a_device_tree_is_read_from_sys_where_proc_has_no_link_to_it(machine, tmp_path):
    machine("jetson_orin_nx", **{"etc/nv_tegra_release": None})
    (tmp_path / "root/proc/device-tree").unlink()
    found = detect(tmp_path / "root")
    assert found.accelerator is Accelerator.JETSON
    assert found.model.startswith("NVIDIA Jetson Orin NX")


CUDA, ROCM, VAAPI, V4L2, NONE = (
    Accelerator(name) for name in ("cuda", "rocm", "vaapi", "v4l2", "none")
)
QCOM = {"dev/video1": "", "sys/class/video4linux/video1/name": "qcom-venus-encoder\n"}
NO_TEGRA_NODES = {
    path: None for path in EXAMPLES["jetson_orin_nx"].files if path.startswith("dev/nv")
}


@pytest.mark.parametrize(
    ("name", "changes", "asked", "says", "chosen"),
    [
        ("jetson_orin_nx", NO_TEGRA_NODES, Accelerator.JETSON, "without NVIDIA's runtime", NONE),
        ("wsl2", {"usr/lib/wsl/lib/libcuda.so.1.1": None}, CUDA, "not NVIDIA's", NONE),
        ("jetson_orin_nx", {}, CUDA, "display", Accelerator.JETSON),
        ("workstation_rtx", {}, CUDA, "driver 565.57.01 with 1 card", CUDA),
        ("workstation_rtx", {"dev/nvidia0": None}, CUDA, "without /dev/nvidia0", VAAPI),
        ("steam_deck", {}, ROCM, "gfx1033 is not on AMD's list", VAAPI),
        ("desktop_rocm", {"dev/dri/renderD128": None}, ROCM, "render node is missing", NONE),
        ("raspberry_pi_5", {}, V4L2, "HEVC decoder only: the processor encodes", V4L2),
        ("riscv_board", QCOM, V4L2, "unknown formats (qcom-venus-encoder)", V4L2),
        ("container", {}, NONE, "container", NONE),
    ],
)
def test_the_reason_says_what_is_there_and_what_is_missing(
    machine, name, changes, asked, says, chosen
):
    found = machine(name, **changes)
    assert says in found.evidence_of(asked).reason
    assert found.accelerator is chosen


@pytest.mark.parametrize(
    ("name", "changes", "devices", "groups"),
    [
        ("steam_deck", {}, "/dev/dri/renderD128", {"render": 992}),
        ("desktop_rocm", {}, "/dev/kfd /dev/dri/renderD128", {"render": 992}),
        ("raspberry_pi_5", {}, "/dev/video19", {"video": 44}),
        ("raspberry_pi_4", {}, "/dev/video10 /dev/video11 /dev/video19", {"video": 44}),
        (
            "laptop_intel",
            {"etc/group": "render:x:junk:\n"},
            "/dev/dri/renderD128",
            {"render": None},
        ),
        ("wsl2", {}, "/dev/dxg", {}),
    ],
)
def test_a_container_is_given_the_chosen_ones_nodes_and_groups_alone(
    machine, name, changes, devices, groups
):
    found = machine(name, **changes)
    assert found.devices == tuple(devices.split())
    assert {group.name: group.gid for group in found.groups} == groups


@pytest.mark.parametrize(
    ("version", "name"),
    [
        (90010, "gfx90a"),
        (90402, "gfx942"),
        (100303, "gfx1033"),
        (110000, "gfx1100"),
        (120001, "gfx1201"),
    ],
)
def test_kernel_s_gfx_target_versions_become_llvm_s_names(version, name):
    assert gfx_name(version) == name


@pytest.mark.parametrize("place", ["missing", "file", "x" * 300])
def test_a_root_that_is_no_folder_is_refused_by_name(tmp_path, place):
    (tmp_path / "file").touch()
    with pytest.raises(
        DeployError, match=r"given as a machine's root, allowed: a folder that exists"
    ):
        detect(tmp_path / place)


@pytest.mark.parametrize("target", ["{outside}", "../../outside", "/../outside", "/outside"])
def test_no_link_leads_out_of_the_root(machine, tmp_path, target):
    outside = tmp_path / "outside"
    outside.write_text("PRETTY_NAME=leaked\n", encoding="utf-8")
    machine("riscv_board", **{"etc/os-release": None})
    (tmp_path / "root/etc/os-release").symlink_to(target.format(outside=outside))
    assert detect(tmp_path / "root").operating_system == "unknown"


@pytest.mark.parametrize("bits", [32, 64])
@pytest.mark.parametrize("known", ELF_MACHINES)
def test_programs_headers_tell_the_architecture_or_what_else_it_is(tmp_path, known, bits):
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin/sh").write_bytes(elf_header(known, bits=bits))
    architecture, reason = find_architecture(MachineFiles(tmp_path))
    if bits == 64 and known in {"amd64", "arm64"}:
        assert (architecture, reason) == (Architecture(known), "from the ELF header of /bin/sh")
    else:
        assert architecture is None
        assert reason.endswith("there are no images for it, allowed: amd64, arm64")


def test_a_loader_tells_the_architecture_where_there_is_no_shell_and_without_it_nothing_does(
    tmp_path,
):
    architecture, reason = find_architecture(MachineFiles(tmp_path))
    assert architecture is None
    assert reason.startswith("not known: no program with an ELF header")
    (tmp_path / "lib").mkdir()
    (tmp_path / "lib/ld-linux-aarch64.so.1").write_bytes(elf_header("arm64"))
    found = find_architecture(MachineFiles(tmp_path))
    assert found == (Architecture.ARM64, "from the ELF header of /lib/ld-linux-aarch64.so.1")


def test_only_the_own_root_asks_the_kernel_for_its_architecture(monkeypatch):
    monkeypatch.setattr(MachineFiles, "head", lambda *_: None)
    monkeypatch.setattr(platform, "machine", lambda: "aarch64")
    found = find_architecture(MachineFiles(Path("/")))
    assert found == (Architecture.ARM64, "from the kernel's own name for it")


def test_this_machine_is_detected_without_a_word_against_its_own_files():
    check_honest(detect())


ENCODER, DECODER = CodecRole.ENCODER, CodecRole.DECODER
TRIED = {ENCODER: ENCODERS, DECODER: DECODERS}
SOFTWARE = {("libx264", ENCODER), ("h264", DECODER)}


def expected(machine):
    return {(codec.name, codec.role) for codec in expected_codecs(machine)}


NANO = {"sys/firmware/devicetree/base/model": "NVIDIA Jetson Orin Nano Developer Kit\0"}


@pytest.mark.parametrize(
    ("name", "codecs", "changes"),
    [
        ("jetson_orin_nx", {("h264_nvmpi", ENCODER), ("h264_nvmpi", DECODER)}, {}),
        ("jetson_orin_nx", {("h264_nvmpi", DECODER)}, NANO),  # it has no encoder
        ("workstation_rtx", {("h264_nvenc", ENCODER), ("h264_cuvid", DECODER)}, {}),
        ("desktop_rocm", {("h264_vaapi", ENCODER)}, {}),
        (
            "laptop_intel",
            {("h264_vaapi", ENCODER), ("h264_qsv", ENCODER), ("h264_qsv", DECODER)},
            {},
        ),
        ("raspberry_pi_4", {("h264_v4l2m2m", ENCODER), ("h264_v4l2m2m", DECODER)}, {}),
        ("raspberry_pi_5", set(), {}),
    ],
)
def test_each_machine_lets_one_expect_its_own_codecs_and_the_processor_s(
    name, codecs, changes, machine
):
    assert expected(machine(name, **changes)) == codecs | SOFTWARE
    assert codecs | SOFTWARE <= {(codec, role) for role in CodecRole for codec in TRIED[role]}


def test_all_codecs_are_tried_here_and_told_beside_what_the_machine_promises(machine):
    found = machine("raspberry_pi_4")
    rows = {(row.name, row.role): row for row in codecs_found(found)}
    assert list(rows) == [(name, role) for role in CodecRole for name in TRIED[role]]
    assert {key for key, row in rows.items() if row.expected} == expected(found)
    assert rows["h264_v4l2m2m", DECODER].why == "stateful V4L2 codec of the board"
    assert rows["h264_nvenc", ENCODER].why == "not expected on this machine"
    for name in ENCODERS:
        probe = probe_encoder(name)
        assert (rows[name, ENCODER].works, rows[name, ENCODER].tried) == (probe.works, probe.reason)
    assert rows["libx264", ENCODER].works
    assert rows["h264", DECODER].works
    text = render_machine(found, tuple(rows.values()))
    for row in rows.values():
        expected_and_works = f"{'yes' if row.expected else 'no':8} {'yes' if row.works else 'no':6}"
        assert (
            f"  {row.name:14} {row.role.value:8} {expected_and_works} {row.tried}; {row.why}\n"
            in text
        )


def test_a_report_tells_for_every_accelerator_what_was_found_and_why(machine):
    found = machine("steam_deck")
    text = render_machine(found)
    lines = text.splitlines()
    assert set(lines) >= {
        "Model:            Valve Galileo",
        "Accelerator:      vaapi",
        "Groups:           render (992)",
        "* vaapi   found: graphics of AMD with a video engine",
        "  rocm    not found: gfx1033 is not on AMD's list of supported chips",
    }
    assert len([line for line in lines if "found: " in line]) == len(ORDER)
    assert "PyAV" not in text


def test_a_report_names_an_architecture_that_has_no_images(machine):
    text = render_machine(machine("riscv_board"))
    assert (
        "Architecture:     riscv64, from the ELF header of /bin/sh: there are no images for it"
        in text
    )
