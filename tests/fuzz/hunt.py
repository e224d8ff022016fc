"""Many tries in processes of their own, which may crash or hang: ``python -m tests.fuzz.hunt KIND FIRST SECONDS``.

Prints the number of tries, and each fault with its seed. ``try_recording(KIND, SEED, folder)`` repeats it.
"""

import contextlib
import dataclasses
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
_RECORD = "<Q"


@dataclasses.dataclass
class Findings:
    """What a hunt found.

    Attributes:
        tries: Number of tries.
        outcomes: How many were read or refused.
        faults: Faults by seed.
    """

    tries: int = 0
    outcomes: Counter = dataclasses.field(default_factory=Counter)
    faults: dict[int, str] = dataclasses.field(default_factory=dict)


def hunt(kind: str, first: int, seconds: float) -> Findings:
    """Make tries for some seconds.

    Args:
        kind: A format of recordings, or a kind of TOML file.
        first: Seed of the first try.
        seconds: How long.
    """
    findings, end, seed = Findings(), time.monotonic() + seconds, first
    with tempfile.TemporaryDirectory() as folder:
        while time.monotonic() < end:
            begun = seed
            seed = _run(kind, seed, end, Path(folder), findings)
            if seed == begun:  # the process did not come to its first try
                raise RuntimeError(f"no try of {kind} from seed {seed}: {findings.faults}")
    findings.tries = seed - first
    return findings


def _run(kind: str, seed: int, end: float, folder: Path, findings: Findings) -> int:
    """Make tries in a process until it ends, and return the seed of the next one."""
    place = folder / "place"
    place.write_bytes(struct.pack(_RECORD, seed))
    command = [
        sys.executable,
        "-m",
        "tests.fuzz.hunt",
        "--worker",
        kind,
        str(seed),
        str(folder),
        str(end - time.monotonic()),
    ]
    with (folder / "output").open("w+b") as output:
        process = subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT)
        reached, since, hangs = seed, time.monotonic(), False
        while process.poll() is None:
            time.sleep(0.2)
            (now,) = struct.unpack(_RECORD, place.read_bytes()[:8].ljust(8, b"\0"))
            if now != reached:
                reached, since = now, time.monotonic()
            elif time.monotonic() - since > _HANGS_AFTER:
                process.kill()
                hangs = True
        (now,) = struct.unpack(_RECORD, place.read_bytes())
        output.seek(0)
        text = output.read().decode("utf-8", "replace")
    for line in text.splitlines():
        if line.startswith("FAULT "):
            _, number, message = line.split(" ", 2)
            findings.faults[int(number)] = message
        elif line.startswith("OUTCOMES "):
            findings.outcomes.update(dict(zip(("read", "refused"), map(int, line.split()[1:]), strict=True)))
    if process.returncode != 0 or hangs:
        findings.faults[now] = "hangs" if hangs else f"ends the process with {process.returncode}: {text[-500:]!r}"
        return now + 1
    return now


def work(kind: str, first: int, folder: Path, seconds: float) -> None:
    """Make tries in this process; the seed of each is stored before it begins."""
    from tests.fuzz import attempts, settings

    with contextlib.suppress(ImportError):
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (_ADDRESS_SPACE, _ADDRESS_SPACE))
    attempt = attempts.try_recording if kind in attempts.FORMATS else settings.try_settings
    end, seed, outcomes = time.monotonic() + seconds, first, Counter()
    place = os.open(folder / "place", os.O_RDWR)
    while time.monotonic() < end:
        os.pwrite(place, struct.pack(_RECORD, seed), 0)
        try:
            outcomes[attempt(kind, seed, folder)] += 1
        except (Exception, attempts.TooSlow) as error:
            frames = [f"{Path(f.filename).name}:{f.lineno}" for f in traceback.extract_tb(error.__traceback__)[-4:]]
            print(
                "FAULT",
                seed,
                f"{type(error).__name__} {error} ({' '.join(frames)})".replace("\n", " ")[:400],
                flush=True,
            )
        seed += 1
    os.pwrite(place, struct.pack(_RECORD, seed), 0)
    print("OUTCOMES", outcomes["read"], outcomes["refused"])


if __name__ == "__main__":
    if sys.argv[1] == "--worker":
        work(sys.argv[2], int(sys.argv[3]), Path(sys.argv[4]), float(sys.argv[5]))
    else:
        result = hunt(sys.argv[1], int(sys.argv[2]), float(sys.argv[3]))
        print(sys.argv[1], result.tries, dict(result.outcomes), len(result.faults), "faults")
        for number, message in result.faults.items():
            print(number, message)
