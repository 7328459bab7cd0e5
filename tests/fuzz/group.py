"""Fuzzing of some doors in a process of bounded memory: ``group.py GROUP SECONDS SEED``, counts as JSON.

With zero seconds, each door is given `FEW` inputs.
"""

import importlib
import json
import random
import re
import resource
import signal
import sys
import time
import traceback
from pathlib import Path

FEW = 100
MEMORY_BYTES, TIME_S = 300e6, 1.0
WORDS = (
    b"\0 \xff\xff\xff\xff \xff\xff\xff\x7f \0\0\0\x80 -1 [ { } /* */ // \" ' \\ &a *a !!int !!timestamp :"
    b" 1e999 nan [1000000000] p/X \xf0\x9f\x98\x80 ../"
).split(b" ")
WORDS += [b"\0" * 64, b"9" * 400, b"[" * 60, b"a" * 40, b": ", b"\n", b"=" * 80 + b"\nMSG: p/Z\n"]


def drawn(rng, door):
    """A friend's input with a few changes: words put in, stretches overwritten, doubled, taken out."""
    data = bytearray(rng.choice(door.begins))
    for _ in range(rng.randrange(7)):
        word = rng.choice(WORDS) if rng.randrange(2) else rng.randbytes(rng.randrange(1, 9))
        at, size = rng.randrange(len(data) + 1), rng.randrange(32)
        old = bytes(data[at : at + size])
        data[at : at + size] = (word, word + old, 2 * old, b"", 8 * word)[rng.randrange(5)]
    return bytes(data)


def fault_of(door, data):
    """Why a door is not sound with an input; None where it is."""
    signal.setitimer(signal.ITIMER_VIRTUAL, 5 * TIME_S)
    started = time.process_time()
    try:
        door.read(data)
    except door.refuses as error:
        str(error)
    except Exception as error:  # noqa: BLE001 - what it was is the finding
        return f"{error!r:.300}\n{''.join(traceback.format_tb(error.__traceback__)[-3:])}"
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0)
    took_s = time.process_time() - started
    return f"took {took_s:.1f} s" if took_s > TIME_S else None


def tried(name, data):
    counts[name] += 1
    if fault := fault_of(DOORS[name], data):
        faults[name] = f"{data[:300]!r} {fault}"
    return name not in faults


def too_slow(*_):
    raise TimeoutError


def by_chance(seconds, seed):
    rng, ends = random.Random(seed), time.monotonic() + seconds
    for name, door in DOORS.items():
        for _ in range(FEW):
            tried(name, drawn(rng, door))
    while time.monotonic() < ends:
        for name in DOORS.keys() - faults.keys():
            until = time.monotonic() + 0.2  # each as long as any other
            while time.monotonic() < until and tried(name, drawn(rng, DOORS[name])):
                pass


def kept(what):
    """Bytes of memory by a line of this process's status."""
    return 1024 * int(re.search(rf"{what}:\s+(\d+)", Path("/proc/self/status").read_text())[1])


group = importlib.import_module(f"doors.{sys.argv[1]}")
DOORS = group.DOORS
signal.signal(signal.SIGVTALRM, too_slow)
counts, faults = dict.fromkeys(DOORS, 0), {}
friendly = [(name, begin) for name, door in DOORS.items() for begin in door.begins]
for name, data in friendly:  # what is imported late is imported now
    fault_of(DOORS[name], data)
most = int(kept("VmData") + MEMORY_BYTES - kept("VmRSS"))
resource.setrlimit(resource.RLIMIT_DATA, (most, most))
for name, data in (*friendly, *group.ATTACKS):
    tried(name, data)
by_chance(float(sys.argv[2]), int(sys.argv[3]))
result = {
    "inputs": sum(counts.values()),
    "counts": counts,
    "faults": faults,
    "peak_mb": kept("VmHWM") / 1e6,
}
sys.stdout.write(json.dumps(result) + "\n")
