from __future__ import annotations

import pytest

from sfglab.codecs.libav import has_start_code, is_entry_point, nal_unit_types

SPS, PPS, SEI, IDR, P = b"\x67abc", b"\x68abc", b"\x06abc", b"\x65abc", b"\x41abc"


def annexb(*units: bytes, code: bytes = b"\0\0\0\1") -> bytes:
    return b"".join(code + unit for unit in units)


@pytest.mark.parametrize("code", [b"\0\0\1", b"\0\0\0\1"])
def test_units_are_found_behind_either_start_code(code):
    data = annexb(SPS, PPS, SEI, IDR, code=code)
    assert has_start_code(data)
    assert list(nal_unit_types(data, codec="h264")) == [7, 8, 6, 5]


@pytest.mark.parametrize("data", [b"", b"\0", b"\0\0\1", b"\0\0\0\1", b"\0\0\1" * 3 + b"\0\0"])
def test_a_start_code_without_a_unit_yields_nothing_false(data):
    assert not is_entry_point(data, codec="h264")


def test_length_prefixed_units_are_not_annex_b():
    assert not has_start_code(b"\0\0\0\4" + IDR)


@pytest.mark.parametrize(
    ("units", "entry"),
    [((IDR,), True), ((SPS, PPS), True), ((P,), False), ((SEI, P), False), ((PPS, P), False), ((P, IDR), True)],
)
def test_h264_starts_at_an_idr_slice_or_parameter_sets(units, entry):
    assert is_entry_point(annexb(*units), codec="h264") is entry


@pytest.mark.parametrize(
    ("kind", "entry"), [(0, False), (1, False), (16, True), (19, True), (21, True), (32, True)]
)
def test_h265_starts_at_an_irap_slice_or_parameter_sets(kind, entry):
    assert is_entry_point(annexb(bytes([kind << 1, 1]) + b"abc"), codec="hevc") is entry
