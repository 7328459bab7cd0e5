"""What hardware lets one expect of FFmpeg, beside what PyAV really opens; and how both are told."""

from __future__ import annotations

import pytest

from sfglab.codecs.probe import DECODERS, ENCODERS, probe_encoder
from sfglab.deploy.hardware.detection import codecs_found, detect, expected_codecs
from sfglab.deploy.hardware.machine import CodecRole, render_machine
from sfglab.lab.example_machines import EXAMPLES, write_example

ENCODER, DECODER = CodecRole.ENCODER, CodecRole.DECODER
SOFTWARE = {("libx264", ENCODER), ("h264", DECODER)}


def machine_of(name, folder):
    return detect(write_example(EXAMPLES[name], folder / name))


def expected(machine):
    return {(codec.name, codec.role) for codec in expected_codecs(machine)}


@pytest.mark.parametrize(
    ("name", "codecs"),
    [
        ("jetson_orin_nx", {("h264_nvmpi", ENCODER), ("h264_nvmpi", DECODER)}),
        ("workstation_rtx", {("h264_nvenc", ENCODER), ("h264_cuvid", DECODER)}),
        ("wsl2", {("h264_nvenc", ENCODER), ("h264_cuvid", DECODER)}),
        ("desktop_rocm", {("h264_vaapi", ENCODER)}),
        ("steam_deck", {("h264_vaapi", ENCODER)}),
        ("laptop_intel", {("h264_vaapi", ENCODER), ("h264_qsv", ENCODER), ("h264_qsv", DECODER)}),
        ("raspberry_pi_4", {("h264_v4l2m2m", ENCODER), ("h264_v4l2m2m", DECODER)}),
        ("raspberry_pi_5", set()),
        ("virtual_machine", set()),
    ],
)
def test_each_machine_lets_one_expect_its_own_codecs_and_the_processor_s(name, codecs, tmp_path):
    assert expected(machine_of(name, tmp_path)) == codecs | SOFTWARE
    assert codecs | SOFTWARE <= {(codec, ENCODER) for codec in ENCODERS} | {
        (codec, DECODER) for codec in DECODERS
    }


def test_an_orin_nano_has_no_encoder(tmp_path):
    root = write_example(EXAMPLES["jetson_orin_nx"], tmp_path / "nano")
    model = "NVIDIA Jetson Orin Nano Developer Kit\0"
    (root / "sys/firmware/devicetree/base/model").write_text(model, encoding="utf-8")
    assert expected(detect(root)) == {("h264_nvmpi", DECODER)} | SOFTWARE


def test_all_codecs_are_tried_here_and_joined_with_what_the_machine_promises(tmp_path):
    machine = machine_of("raspberry_pi_4", tmp_path)
    rows = {(row.name, row.role): row for row in codecs_found(machine)}
    assert list(rows) == [(name, ENCODER) for name in ENCODERS] + [(name, DECODER) for name in DECODERS]
    assert {key for key, row in rows.items() if row.expected} == expected(machine)
    assert rows["h264_v4l2m2m", DECODER].why == "stateful V4L2 codec of the board"
    assert rows["h264_nvenc", ENCODER].why == "not what this machine's v4l2 is used through"
    for name in ENCODERS:
        probe = probe_encoder(name)
        assert (rows[name, ENCODER].works, rows[name, ENCODER].tried) == (probe.works, probe.reason)
    assert rows["libx264", ENCODER].works
    assert rows["h264", DECODER].works


def test_a_report_tells_for_every_accelerator_what_was_found_and_why(tmp_path):
    machine = machine_of("steam_deck", tmp_path)
    text = render_machine(machine)
    lines = text.splitlines()
    assert set(lines) >= {
        "Model:            Valve Galileo",
        "Accelerator:      vaapi",
        "Groups:           render (992)",
        "* vaapi   found: graphics of AMD with a video engine",
        "          chosen: encodes and decodes H.264",
        "          - /dev/kfd",
    }
    for item in machine.evidence:
        assert any(line[2:].startswith(item.accelerator.value) and item.reason in line for line in lines)
        assert all(f"          - {source}" in lines for source in item.sources)
    assert "PyAV" not in text


def test_a_report_with_codecs_has_a_row_for_each(tmp_path):
    machine = machine_of("virtual_machine", tmp_path)
    rows = codecs_found(machine)
    text = render_machine(machine, rows)
    for row in rows:
        expected_and_works = f"{'yes' if row.expected else 'no':8} {'yes' if row.works else 'no':6}"
        assert f"  {row.name:14} {row.role.value:8} {expected_and_works} {row.tried}; {row.why}\n" in text


def test_a_report_names_an_architecture_that_has_no_images(tmp_path):
    text = render_machine(machine_of("riscv_board", tmp_path))
    assert "Architecture:     riscv64, from the ELF header of /bin/sh: there are no images for it" in text
