"""The experiment on decoding once: known costs are found again, and processes see the right frames."""

import asyncio
import os
import signal
from contextlib import closing
from dataclasses import replace

import numpy as np
import pandas as pd
import psutil
import pytest
from made_logs import CLAIMS, made_run, reference

from sfglab.bus import Node
from sfglab.errors import InvalidValueError
from sfglab.fleet.decoder.streams import routes_of_topic
from sfglab.lab.bench import Options
from sfglab.lab.claims import Verdict, entry_for
from sfglab.lab.experiments.decode_once import cost_model, decoding_costs, exp, results
from sfglab.lab.experiments.decode_once.experiment import check_counts, groups_of
from sfglab.lab.experiments.decode_once.live import HOSTS, LOCAL_DOMAIN, Processes
from sfglab.lab.sources import open_source
from sfglab.lab.testbed import Testbed
from sfglab.lab.workers.viewer import IMAGE
from sfglab.messages import ns_from_stamp
from sfglab.qos import SENSOR_DATA
from sfglab.record import LogReader

NET, DEC, IPC = 1.5, 5.0, {"dds": 2.0, "proxy": 0.5}


def cost(mode, count, ipc):
    """Eq. 2 and 3 with known terms."""
    alone = {"standard": count * (NET + DEC), "network": count * NET}
    return alone.get(mode, NET + DEC + count * ipc.get(mode, 0))


def make(path, *, modes=("standard", "dds", "proxy"), repeats=1, ipc=IPC, load=None, **seen):
    """A log with costs that are exactly Eq. 2 and 3 but for what `load` makes of them."""
    cells = ([(m, n) for n in range(1, 11) for m in modes] + [("network", 5)]) * repeats
    tables = {"cell": [], "load": [], "view": []}
    for cell, (mode, count) in enumerate(cells):
        tables["cell"].append({"cell": cell, "mode": mode, "subscribers": count})
        for label, cpu in (("consumer", cost(mode, count, ipc)), ("edge", 20.0)):
            row = {"cell": cell, "label": label, "cpu_percent": load(cell, cpu) if load else cpu}
            tables["load"] += 2 * [{**row, "rx_mbit_s": 4.0 * (1 if mode in IPC else count)}]
        tables["view"].append({"cell": cell, "frames": 30, **seen.get(mode, {})})
    return made_run(exp, path, tables, stream_h264={"encoder": "libx264"})


@pytest.fixture
def made(tmp_path):
    return make(tmp_path / "made.mcap")


@pytest.fixture(autouse=True)
def stream(monkeypatch):
    """The recorded stream, as in Table 2: made logs have no messages."""
    table = pd.DataFrame({"number": range(91), "width": 640, "height": 360, "size_bytes": 16_667})
    table = table.assign(stamp_ns=table["number"] * 1e9 / 30, is_key=table["number"] % 30 == 0)
    monkeypatch.setattr(results, "packets", lambda _: table)
    return table


def judged(claim, run):
    return entry_for(CLAIMS[claim], exp.measure(run).get(claim))


def test_slopes_reduction_and_terms_of_known_costs_are_found_and_explain_everything(made):
    received = {mode: results.slope(made, mode, "rx").value for mode in ("standard", "dds")}
    assert received == pytest.approx({"standard": 4, "dds": 0})
    for way, ipc in IPC.items():
        assert results.slope(made, way, "cpu").value == pytest.approx(ipc)
        less = results.reduction(made, way)
        assert less.value == pytest.approx(100 * (1 - ipc / (NET + DEC)))
        model = cost_model(made, way=way)
        terms = [term.value for term in (model.net, model.dec, model.ipc)]
        assert terms == pytest.approx([NET, DEC, ipc])
        assert model.residual.value == pytest.approx(0, abs=1e-9)
        assert model.explained == pytest.approx(1)


@pytest.mark.parametrize(
    ("changes", "verdicts"),
    [
        ({}, {"A-CPU-SFG": "reproduced", "A-CPU-OURS": "better", "A-BW": "reproduced"}),
        ({"dds": {"missed": 2}}, {"A-CPU-SFG": "deviates", "A-CPU-OURS": "better"}),
        ({"ipc": {"dds": 2, "proxy": 9}}, {"A-CPU-SFG": "reproduced", "A-CPU-OURS": "deviates"}),
    ],
)
def test_each_way_of_passing_pictures_on_is_judged_by_itself(tmp_path, changes, verdicts):
    run = make(tmp_path / "made.mcap", **changes)
    assert {claim: judged(claim, run).verdict.value for claim in verdicts} == verdicts


@pytest.mark.parametrize(
    ("field", "value"), [("counts", (1,)), ("dds_counts", (1, 9)), ("network_counts", ())]
)
def test_numbers_of_subscribers_without_enough_for_a_fit_are_refused_before_they_run(field, value):
    config = exp.config("smoke")
    check_counts(config)
    with pytest.raises(InvalidValueError, match=rf"^{field}: given "):
        check_counts(replace(config, **{field: value}))


@pytest.mark.parametrize(
    ("verdict", "load"),
    [
        # A machine that slows down slows the camera too.
        (
            Verdict.REPRODUCED,
            lambda n, cpu: cpu * (1 + 0.3 * (n // 10 % 2) + 1e-3 * (cpu != 20) * (n % 2)),
        ),
        # A residual of a few per cent, which the scatter of repetitions does not account for.
        (Verdict.DEVIATES, lambda n, cpu: cpu + (cpu != 20) * (1 + 1e-3 * n)),
    ],
)
def test_the_cost_model_is_judged_at_one_pace_by_its_residual_and_by_its_lack_of_fit(
    tmp_path, load, verdict
):
    run = make(tmp_path / "made.mcap", repeats=2, load=load)
    entry = judged("A-COST", run)
    assert entry.measured.estimate.value < 10
    assert entry.verdict is verdict, entry.reason
    assert ("finds a lack of fit" in entry.reason) == (verdict is Verdict.DEVIATES)


@pytest.mark.parametrize(
    ("column", "value", "verdict"),
    [
        ("width", 640, "reproduced"),
        ("width", 848, "deviates"),
        ("height", 480, "deviates"),
        ("size_bytes", 8000, "deviates"),
        ("stamp_ns", np.arange(91) * 1e9 / 15, "deviates"),
        ("is_key", np.arange(91) % 31 == 0, "deviates"),
        ("is_key", np.isin(np.arange(91), [0, 30, 80]), "deviates"),
        ("is_key", np.arange(91) == 0, "deviates"),
    ],
)
def test_size_frame_rate_group_and_bit_rate_all_decide(made, stream, column, value, verdict):
    stream[column] = value
    assert judged("A-H264", made).verdict.value == verdict


def test_cells_are_measured_in_the_order_of_the_committed_log_and_modes_of_a_count_together():
    run = reference(exp)
    groups = groups_of(run.config)
    rows = pd.DataFrame([cell for group in groups for cell in group])
    assert run["cell"][rows.columns].equals(rows)
    for group in groups:
        assert len({(cell.subscribers, cell.repeat) for cell in group}) == 1
        modes = {cell.mode for cell in group}
        assert modes == {"network"} or modes >= {"standard", "proxy"}


def test_the_explorer_has_the_reference_s_costs_and_scales_them():
    fit = cost_model(reference(exp))

    def costs(**setting):
        shown = decoding_costs(subscribers=7, **setting).at("CPU by Eq. 2 and 3", 7)
        return shown.set_index("series")["y"]

    usual = costs()
    standard, dds = usual[results.LABELS["standard"]], usual[results.LABELS["dds"]]
    assert standard == pytest.approx(7 * (fit.net.value + fit.dec.value))
    assert dds == pytest.approx(fit.net.value + fit.dec.value + 7 * fit.ipc.value)
    more = costs(picture_size="1920 x 1080", rate_hz=60.0)
    assert more.to_dict() == pytest.approx((18 * usual).to_dict())
    assert (costs(hardware_decoding=True) < usual).all()


# --- Live -------------------------------------------------------------------------------------


@pytest.mark.live
async def test_the_stamp_of_a_received_picture_is_that_of_the_frame_in_its_pixels():
    config = exp.config("smoke", encoder="libx264")
    received = []

    def take(image):
        pixels = np.array(image.data).reshape(image.height, image.width, 3)
        received.append((ns_from_stamp(image.header.stamp), pixels))

    with Testbed(*HOSTS, separate=False) as testbed:
        async with Processes(config, testbed) as processes:
            [route, *_] = routes_of_topic(processes.topic)
            async with Node("here", domain_id=LOCAL_DOMAIN, interface="lo") as here:
                here.create_subscription(IMAGE, route.local_topic, take, SENSOR_DATA)
                await processes.look(1, mode="proxy")
                received.clear()
                async with asyncio.timeout(60):
                    while len(received) < 40:
                        await asyncio.sleep(0.1)
                [seen] = await processes.stop(1)
    assert (seen["unreadable"], seen["disordered"], seen["broken"]) == (0, 0, 0)
    assert len(seen["sightings"]) == seen["frames"] > 10
    numbers = {stamp_ns: number for number, stamp_ns, _ in processes.sent}
    with closing(open_source(config.source, seed=config.seed)) as source:
        frames = [source.frame().bgr.astype(int) for _ in range(max(numbers.values()) + 3)]
    for stamp_ns, pixels in received[-10:]:
        number = numbers[stamp_ns]
        first = max(0, number - 2)
        errors = [np.abs(frame - pixels).mean() for frame in frames[first : number + 3]]
        assert np.argmin(errors) == number - first


@pytest.mark.live
@pytest.mark.slow
def test_an_interrupted_run_ends_its_processes_and_keeps_what_was_measured(tmp_path, monkeypatch):
    log, journal = tmp_path / "run.mcap", tmp_path / "decode_once-smoke-cells.journal"
    measure, children = Processes.measure, []

    async def interrupted(processes, cell):
        # After the first group of cells.
        if journal.read_bytes().count(b"\n") == 2:
            children.extend(psutil.Process().children(recursive=True))
            os.kill(os.getpid(), signal.SIGINT)
        return await measure(processes, cell)

    monkeypatch.setattr(Processes, "measure", interrupted)
    changes = {"counts": (1, 2), "dds_counts": (1, 2), "network_counts": (1,)}
    options = Options(separate=False)
    with pytest.raises(KeyboardInterrupt):
        asyncio.run(exp.run("smoke", path=log, options=options, encoder="libx264", **changes))
    assert len(children) >= 3
    _, alive = psutil.wait_procs(children, timeout=60)
    assert not alive
    assert not log.exists(), "it is not finished"
    assert b'"load"' in journal.read_bytes().splitlines()[1], "the next run goes on behind it"
    with LogReader(tmp_path / "run.mcap.part") as reader:
        assert not reader.truncated
