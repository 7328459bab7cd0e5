from __future__ import annotations

import pytest

from sfglab.codecs import CodecError, CodecUnavailableError, available_decoders, available_encoders, probe
from sfglab.codecs.libav import EncodedFrame, EncoderSession


def test_every_candidate_gets_a_verdict_with_a_reason():
    for probes, names in ((available_encoders(), probe.ENCODERS), (available_decoders(), probe.DECODERS)):
        assert tuple(verdict.name for verdict in probes) == names
        assert all(verdict.reason for verdict in probes)
        assert all(verdict.hardware is (verdict.name not in probe.SOFTWARE) for verdict in probes)


def test_the_software_decoder_works_wherever_a_software_encoder_does():
    assert probe.probe_encoder("libx264").works
    assert probe.probe_decoder("h264").works


def test_a_verdict_is_reached_once():
    assert probe.probe_encoder("libx264") is probe.probe_encoder("libx264")


def test_a_codec_that_was_compiled_in_is_not_thereby_there():
    import av

    compiled = [name for name in probe.ENCODERS if name in av.codecs_available]
    assert set(compiled) >= {verdict.name for verdict in available_encoders() if verdict.works}


def broken(change):
    """Return an encoder session whose frames are changed on the way out."""

    class Broken(EncoderSession):
        def encode(self, image_bgr, *, force_key=False):
            return change(super().encode(image_bgr, force_key=force_key))

    return Broken


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda frames: frames[1:], "wanted 1 at once"),
        (lambda frames: frames * 2, "wanted 1 at once"),
        (lambda frames: tuple(EncodedFrame(data=f.data, pts=f.pts, is_key=True) for f in frames), "forced key"),
        (
            lambda frames: tuple(EncodedFrame(data=f.data[4:], pts=f.pts, is_key=f.is_key) for f in frames),
            "Annex B",
        ),
        (lambda frames: tuple(EncodedFrame(data=f.data[:40], pts=f.pts, is_key=f.is_key) for f in frames), ""),
    ],
    ids=["none", "two", "all key", "no start code", "cut"],
)
def test_an_encoder_that_opens_but_misbehaves_is_found_out(monkeypatch, change, reason):
    monkeypatch.setattr(probe, "EncoderSession", broken(change))
    verdict = probe.probe_encoder.__wrapped__("libx264")
    assert not verdict.works
    assert reason in verdict.reason


def test_wrong_pictures_are_found_out(monkeypatch):
    monkeypatch.setattr(probe.DecoderSession, "bgr", lambda *_: probe._trial_images()[0] * 0)
    verdict = probe.probe_encoder.__wrapped__("libx264")
    assert "dB" in verdict.reason
    assert not verdict.works


def fake(working: set[str]):
    def verdict(name: str) -> probe.CodecProbe:
        return probe.CodecProbe(name=name, works=name in working, reason="no device", hardware=True)

    return verdict


def test_auto_takes_the_first_that_works_and_says_what_it_passed_over(monkeypatch):
    monkeypatch.setattr(probe, "probe_encoder", fake({"h264_qsv", "libx264"}))
    choice = probe.choose_encoder("auto", fallback=False)
    assert choice.name == "h264_qsv"
    assert choice.fallback_reason == "h264_nvmpi: no device; h264_nvenc: no device"


def test_the_most_preferred_is_no_fallback(monkeypatch):
    monkeypatch.setattr(probe, "probe_encoder", fake({"h264_nvmpi", "libx264"}))
    assert probe.choose_encoder("auto", fallback=False).fallback_reason is None


def test_no_encoder_at_all_names_every_reason(monkeypatch):
    monkeypatch.setattr(probe, "probe_encoder", fake(set()))
    with pytest.raises(CodecUnavailableError, match=r"h264_nvmpi: no device.*libopenh264: no device"):
        probe.choose_encoder("auto", fallback=True)
    assert issubclass(CodecUnavailableError, CodecError)


def test_without_an_encoder_the_software_decoder_is_taken_untried(monkeypatch):
    monkeypatch.setattr(probe, "probe_encoder", fake(set()))
    probe.probe_decoder.cache_clear()
    try:
        assert probe.choose_decoder("auto").name == "h264"
        assert "no software encoder" in probe.probe_decoder("h264_cuvid").reason
    finally:
        probe.probe_decoder.cache_clear()
