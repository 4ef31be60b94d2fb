#!/usr/bin/env python
"""A thousand mixed logs through `mavdem track`: speed-up, memory, kills and a cluster; prints a table.

The logs are simulated flights at 1 to 100 Hz, cuts of recorded ones, and damaged and hostile files. Each run has a
folder of its own; at the end all data sets must be the same, byte for byte. "reading" is how many processes were at
work on logs at a time, "memory" that of all processes of the command together, not of the cluster.

Usage: tools/bench/fleet.py [--logs 1000] [--shared ../shared/data] FOLDER
"""

from __future__ import annotations

import hashlib
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from threading import Thread
from typing import NamedTuple

import click

from mavdem.export.conversion import STREAMS
from mavdem.fleet.ledger import read_ledger
from sitl_scenarios.files import load, scenario_of
from sitl_scenarios.mavlink.recorded import recorded
from sitl_scenarios.simulation import Simulation
from sitl_scenarios.simulation import fly as fly_through

ROOT = Path(__file__).parents[2]
MOTIONS = ("iris_von_karman", "iris_dryden", "ardupilot_steps", "calm", "crazyflie_gusts", "iris_sticks")
SLOW_RATES = (1, 1, 2, 2, 4, 4, 4, 4, 10)  # Hz; most logs of the field have no more
FAST_RATES = (50, 100)
SECONDS = 40.0  # of a simulated flight
FAST_SHARE, RECORDED_SHARE, DAMAGED_SHARE, HOSTILE_SHARE = 0.005, 0.06, 0.12, 0.05
LIMITS = ("--time-limit", "120")
SECONDS_BETWEEN_LOOKS = 0.2


class Run(NamedTuple):
    """One run: wall time, s, and the most memory of all its processes together, MB."""

    seconds: float
    megabytes: float
    load: float


def simulated(chance: random.Random, count: int) -> Iterator[tuple[str, bytes]]:
    """Names and contents: the same few motions at many rates, as two autopilots."""
    motions = {}
    for number in range(count):
        name = MOTIONS[number % len(MOTIONS)]
        if name not in motions:
            scenario = scenario_of(load(name).model_dump(mode="json") | {"duration": SECONDS, "seed": 1})
            motions[name] = scenario, fly_through(scenario)
        scenario, motion = motions[name]
        rate = chance.choice(FAST_RATES if chance.random() < FAST_SHARE / 0.7 else SLOW_RATES)
        values = scenario.model_dump(mode="json")
        values["seed"] = number
        values["stream"] |= {"rate": rate, "rates": {}, "system": 1 + number % 40}
        values["stream"]["speaks"] = chance.choice(("px4", "ardupilot"))
        values["faults"] |= {"loss": chance.choice((0.0, 0.01))}
        sent = scenario_of(values)
        ending = chance.choice((".tlog", ".tlog", ".mcap"))
        place = Path(f"/tmp/fleet-{os.getpid()}{ending}")
        with place.open("wb") as file:
            STREAMS[ending](file, recorded(sent, motion, Simulation(scenario).cycle, lambda _: None))
        yield f"{name}_{rate}hz_{number}{ending}", place.read_bytes()
        place.unlink()


def recordings(shared: Path) -> list[Path]:
    """Recorded logs that are there, not the largest."""
    found = [*(ROOT / "logs").glob("*.tlog"), *shared.glob("logs/*"), *shared.glob("real/*/*.[bBu]*")]
    return sorted(path for path in found if path.is_file() and path.stat().st_size < 8 << 20)


def make_logs(folder: Path, count: int, shared: Path) -> None:
    """Makes ``count`` logs."""
    chance = random.Random(20)
    cuts, damaged, hostile = (round(share * count) for share in (RECORDED_SHARE, DAMAGED_SHARE, HOSTILE_SHARE))
    good = list(simulated(chance, count - cuts - damaged - hostile))
    for number, (name, content) in enumerate(good):
        place = folder / f"day_{number % 7}" / name
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(content)
    known = recordings(shared)
    for number in range(cuts):
        path = known[number % len(known)]
        content = path.read_bytes()
        # A shorter flight: the end is missing, as after a crash.
        cut = content[: round(len(content) * chance.uniform(0.4, 1))]
        (folder / f"recorded_{number}_{path.name}").write_bytes(cut)
    for number in range(damaged):
        name, content = chance.choice(good)
        (folder / f"damaged_{number}_{name}").write_bytes(damage(content, chance))
    (folder / "hostile").mkdir()
    for number in range(hostile):
        make_hostile(folder / "hostile", number, chance)


def damage(content: bytes, chance: random.Random) -> bytes:
    """A content that a bad disk or link left."""
    kind = chance.randrange(4)
    if kind == 0:
        return content[: chance.randrange(200, len(content))]
    if kind == 1:
        return content.replace(b"\n", b"\r\n")
    if kind == 2:
        place = chance.randrange(len(content))
        return content[:place] + chance.randbytes(5000) + content[place:]
    changed = bytearray(content)
    for _ in range(len(content) // 500):
        changed[chance.randrange(len(changed))] ^= 1 << chance.randrange(8)
    return bytes(changed)


def make_hostile(folder: Path, number: int, chance: random.Random) -> None:
    """A file that no log is, but by its name."""
    kinds: list[Callable[[Path], object]] = [
        lambda path: path.write_bytes(b""),
        lambda path: path.write_bytes(chance.randbytes(300_000)),
        lambda path: path.write_bytes(b"PK\x03\x04" + chance.randbytes(999)),
        lambda path: path.write_text("not a log\n" * 999),
        lambda path: path.symlink_to(path.name),
        lambda path: path.symlink_to("/nowhere"),
        lambda path: os.mkfifo(path),
        lambda path: path.write_bytes(b"\xa3\x95\x80" + bytes(1 << 22)),
        lambda path: path.write_bytes(b"ULog\x01\x12\x35\x01" + chance.randbytes(1 << 20)),
        lambda path: path.write_bytes(b"\x89MCAP0\r\n" + chance.randbytes(1 << 20)),
    ]
    ending = chance.choice((".tlog", ".bin", ".ulg", ".mcap"))
    kinds[number % len(kinds)](folder / f"odd\n\x1b[31m \U0001f681 {number}{ending}")


def family(process: int) -> list[int]:
    """A process and all that it started."""
    children: dict[int, list[int]] = {}
    for status in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            parent = int(status.read_text().rpartition(")")[2].split()[1])
            children.setdefault(parent, []).append(int(status.parent.name))
    found = [process]
    for one in found:
        found += children.get(one, [])
    return found


def memory(processes: list[int]) -> float:
    """MB of all of them together; what they share counts once."""
    total = 0
    for one in processes:
        with suppress(OSError, StopIteration):
            lines = Path(f"/proc/{one}/smaps_rollup").read_text().splitlines()
            total += int(next(line for line in lines if line.startswith("Pss:")).split()[1])
    return total / 1024


def watched(command: list[str], kill_after: float | None = None) -> Run:
    """Runs a command to its end, or kills it."""
    began, most = time.perf_counter(), 0.0
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while process.poll() is None:
        most = max(most, memory(family(process.pid)))
        if kill_after is not None and time.perf_counter() - began > kill_after:
            process.send_signal(signal.SIGKILL)
            process.wait()
        time.sleep(SECONDS_BETWEEN_LOOKS)
    return Run(time.perf_counter() - began, most, os.getloadavg()[0])


def command(logs: Path, out: Path, *options: str) -> list[str]:
    return [sys.executable, "-m", "mavdem", "track", str(logs), "--out", str(out), *LIMITS, *options]


def fingerprint(out: Path) -> str:
    """Of the data set, byte for byte."""
    digest = hashlib.sha256()
    for path in sorted((out / "flights").rglob("*.parquet")):
        digest.update(str(path.relative_to(out)).encode() + path.read_bytes())
    return digest.hexdigest()[:12]


def reading(out: Path) -> float:
    """Seconds that all processes together spent on logs: over those of the run, how many were at work at a time."""
    return float(sum(entry.seconds for entry in read_ledger(out).by_path.values()))


def killed_and_resumed(logs: Path, out: Path, whole: float, chance: random.Random) -> str:
    """Kills a run three times at random moments, and lets the fourth end."""
    moments = [chance.uniform(0.1, 0.5) * whole for _ in range(3)]
    for moment in moments:
        watched(command(logs, out, "--jobs", "2"), moment)
    watched(command(logs, out, "--jobs", "2"))
    return f"killed after {', '.join(f'{moment:.0f}' for moment in moments)} s, then resumed"


def on_a_cluster(logs: Path, out: Path, whole: float) -> Run:
    """Two workers of a cluster, one of which is killed."""
    from distributed import LocalCluster

    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None, silence_logs=50) as cluster:  # type: ignore[no-untyped-call]
        victim = next(iter(cluster.workers.values())).pid

        def kill() -> None:
            time.sleep(0.4 * whole)
            os.kill(victim, signal.SIGKILL)

        Thread(target=kill, daemon=True).start()
        return watched(command(logs, out, "--scheduler", cluster.scheduler_address))


@click.command(help=__doc__)
@click.argument("folder", type=click.Path(path_type=Path))
@click.option("--logs", "count", default=1000)
@click.option("--shared", type=click.Path(path_type=Path), default=ROOT.parent / "shared" / "data")
def main(folder: Path, count: int, shared: Path) -> None:
    chance = random.Random(int(time.time()))
    logs = folder / "logs"
    if not logs.exists():
        shutil.rmtree(folder, ignore_errors=True)
        logs.mkdir(parents=True)
        began = time.perf_counter()
        make_logs(logs, count, shared)
        print(f"made {count} logs in {time.perf_counter() - began:.0f} s", flush=True)
    size = sum(path.stat().st_size for path in logs.rglob("*") if path.is_file())
    print(f"{count} logs, {size / 1e6:.0f} MB, {os.cpu_count()} cores; load before: {os.getloadavg()[0]:.1f}\n")
    print("run                       seconds  logs/s  reading  memory MB  load  data set", flush=True)

    def show(name: str, run: Run, out: Path) -> None:
        rates = f"{count / run.seconds:6.2f}  {reading(out) / run.seconds:7.2f}"
        figures = f"{run.seconds:7.0f}  {rates}  {run.megabytes:9.0f}  {run.load:4.1f}"
        print(f"{name:24}  {figures}  {fingerprint(out)}", flush=True)

    two = watched(command(logs, folder / "two", "--jobs", "2"))
    show("2 jobs", two, folder / "two")
    again = watched(command(logs, folder / "two", "--jobs", "2"))
    print(f"again, when all is known: {again.seconds:.0f} s, {again.megabytes:.0f} MB", flush=True)
    one = watched(command(logs, folder / "one", "--jobs", "1"))
    show("1 job", one, folder / "one")
    print(f"2 jobs are {one.seconds / two.seconds:.2f} times as fast as 1", flush=True)
    how = killed_and_resumed(logs, folder / "killed", two.seconds, chance)
    print(f"{how}: {fingerprint(folder / 'killed')}", flush=True)
    show("2 workers, 1 killed", on_a_cluster(logs, folder / "cluster", two.seconds), folder / "cluster")
    prints = {fingerprint(folder / name) for name in ("one", "two", "killed", "cluster")}
    print("all data sets are the same" if len(prints) == 1 else f"THE DATA SETS DIFFER: {prints}")
    sys.exit(len(prints) != 1)


if __name__ == "__main__":
    main()
