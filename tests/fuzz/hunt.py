"""Many tries in processes of their own, which may crash or hang: ``python -m tests.fuzz.hunt KIND FIRST SECONDS``.

Prints the number of tries, and each fault with its seed. ``try_recording(KIND, SEED, folder)`` repeats it.
"""

import contextlib
import dataclasses
import math
import os
import struct
import subprocess
import sys
import tempfile
import time
import traceback
from collections import Counter
from pathlib import Path

# Address space of a process: a file of some kilobytes that asks for more is a fault.
_ADDRESS_SPACE = 8 * 2**30
# Seconds without a new try after which a process hangs: more than the clock in the process allows.
_HANGS_AFTER = 60.0
# Seed of the current try, numbers of files that were read and refused, seconds of processor of the slowest try.
_RECORD = struct.Struct("<QQQd")


@dataclasses.dataclass
class Findings:
    """What a hunt found.

    Attributes:
        tries: Number of tries.
        outcomes: How many were read or refused.
        slowest: Time of the processor of the slowest try that ended, s.
        faults: Faults by seed.
    """

    tries: int = 0
    outcomes: Counter = dataclasses.field(default_factory=Counter)
    slowest: float = 0.0
    faults: dict[int, str] = dataclasses.field(default_factory=dict)


def hunt(kind: str, first: int, seconds: float = math.inf, tries: int = sys.maxsize) -> Findings:
    """Make tries for some seconds, or a number of them.

    Args:
        kind: A format of recordings, or a kind of TOML file.
        first: Seed of the first try.
        seconds: How long at most.
        tries: Largest number of tries.
    """
    findings, end, seed = Findings(), time.monotonic() + seconds, first
    with tempfile.TemporaryDirectory() as folder:
        while time.monotonic() < end and seed < first + tries:
            begun = seed
            seed = _run(kind, range(seed, first + tries), end, Path(folder), findings)
            if seed == begun:  # the process did not come to its first try
                raise RuntimeError(f"no try of {kind} from seed {seed}: {findings.faults}")
    findings.tries = seed - first
    return findings


def _run(kind: str, seeds: range, end: float, folder: Path, findings: Findings) -> int:
    """Make tries in a process until it ends, and return the seed of the next one."""
    place = folder / "place"
    place.write_bytes(_RECORD.pack(seeds.start, 0, 0, 0.0))
    words = [kind, str(seeds.start), str(seeds.stop), str(folder), str(end - time.monotonic())]
    with (folder / "output").open("w+b") as output:
        process = subprocess.Popen(
            [sys.executable, "-m", "tests.fuzz.hunt", "--worker", *words], stdout=output, stderr=subprocess.DEVNULL
        )
        reached, since, hangs = seeds.start, time.monotonic(), False
        while process.poll() is None:
            time.sleep(0.2)
            now = _RECORD.unpack(place.read_bytes())[0]
            if now != reached:
                reached, since = now, time.monotonic()
            elif time.monotonic() - since > _HANGS_AFTER:
                process.kill()
                hangs = True
        now, read, refused, slowest = _RECORD.unpack(place.read_bytes())
        output.seek(0)
        text = output.read().decode("utf-8", "replace")
    findings.outcomes.update({"read": read, "refused": refused})
    findings.slowest = max(findings.slowest, slowest)
    for line in text.splitlines():
        if line.startswith("FAULT "):
            _, number, message = line.split(" ", 2)
            findings.faults[int(number)] = message
    if process.returncode != 0 or hangs:
        findings.faults[now] = "hangs" if hangs else f"ends the process with {process.returncode}: {text[-500:]!r}"
        return now + 1
    return now


def work(kind: str, seeds: range, folder: Path, seconds: float) -> None:
    """Make tries in this process; the seed of each is stored before it begins."""
    from tests.fuzz import attempts, settings

    with contextlib.suppress(ImportError):
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (_ADDRESS_SPACE, _ADDRESS_SPACE))
    attempt = attempts.try_recording if kind in attempts.FORMATS else settings.try_settings
    end, outcomes, slowest = time.monotonic() + seconds, Counter(), 0.0
    place = os.open(folder / "place", os.O_RDWR)

    def store(seed: int) -> None:
        os.pwrite(place, _RECORD.pack(seed, outcomes["read"], outcomes["refused"], slowest), 0)

    for seed in seeds:
        if time.monotonic() >= end:
            store(seed)
            return
        store(seed)
        begin = time.process_time()
        try:
            outcomes[attempt(kind, seed, folder)] += 1
        except (Exception, attempts.TooSlow) as error:
            frames = [f"{Path(f.filename).name}:{f.lineno}" for f in traceback.extract_tb(error.__traceback__)[-4:]]
            message = f"{type(error).__name__} {error} ({' '.join(frames)})".replace("\n", " ")[:400]
            print("FAULT", seed, message, flush=True)
        if seed > seeds.start:  # the first one imports packages
            slowest = max(slowest, time.process_time() - begin)
    store(seeds.stop)


if __name__ == "__main__":
    if sys.argv[1] == "--worker":
        work(sys.argv[2], range(int(sys.argv[3]), int(sys.argv[4])), Path(sys.argv[5]), float(sys.argv[6]))
    else:
        result = hunt(sys.argv[1], int(sys.argv[2]), float(sys.argv[3]))
        print(sys.argv[1], result.tries, dict(result.outcomes), len(result.faults), "faults")
        for number, message in result.faults.items():
            print(number, message)
