#!/usr/bin/env python
"""How fast logs are read, a fleet's rows and live estimates made; prints tables.

Usage: tools/bench/speed.py read FILE.tlog|FILE.bin|FILE.ulg|FILE.mcap ...
       tools/bench/speed.py fleet LOG ...
       tools/bench/speed.py live
"""

from __future__ import annotations

import multiprocessing
import resource
import time
from contextlib import closing, suppress
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from timeit import repeat
from typing import Any

import click
import pandas as pd
from threadpoolctl import threadpool_limits

from mavdem.alignment import drive, signals
from mavdem.cli.live import Dashboard
from mavdem.dem import Settings
from mavdem.dem.parallel import LearningProcess, stay_in_this_process
from mavdem.errors import Unreadable
from mavdem.fleet.row import best_tier
from mavdem.fleet.rows_of_log import rows_of_log
from mavdem.ingest import read_log
from mavdem.live import LiveStream
from mavdem.live.link import Link
from mavdem.live.raw_recording import RawRecording
from mavdem.live.running import run
from mavdem.live.session import LiveSession
from mavdem.report.flight_page import flight_page
from sitl_scenarios.files import scenario_of
from sitl_scenarios.mavlink.live import Ground, fly_live
from sitl_scenarios.simulation import Simulation


def ours(path: str) -> int:
    log = read_log(path)
    for vehicle in log.vehicles:
        for columns in vehicle.messages.values():
            len(columns["time"]) / max(columns["time"][-1] - columns["time"][0], 1e-9)
        signals.attitude(vehicle, "roll")
        drive.motors_or_obstacle(vehicle)
        drive.demand(vehicle, "roll")
    return log.frames


def recv_match(path: str) -> int:
    from pymavlink import mavutil

    kinds = ["ATT", "ANG", "RATE", "IMU", "RCOU", "CTUN", "XKF1", "EV", "ARM", "PARM", "MSG"]
    chosen = {} if path.lower().endswith(".tlog") else {"type": kinds}
    log = mavutil.mavlink_connection(path, robust_parsing=True)
    return sum(1 for _ in iter(partial(log.recv_match, **chosen), None))


def ulog(path: str) -> int:
    from pyulog import ULog

    return sum(len(topic.data["timestamp"]) for topic in ULog(path).data_list)


def mcap(path: str) -> int:
    from mcap.reader import make_reader

    with open(path, "rb") as file:
        return sum(1 for _ in make_reader(file).iter_messages(log_time_order=False))


READERS = {".tlog": recv_match, ".bin": recv_match, ".ulg": ulog, ".mcap": mcap}
"""The usual library of each format."""


def read(logs: tuple[Path, ...]) -> None:
    """How fast a log is read, beside the usual library of its format: the fastest of three runs.

    Ours decodes attitude, motor outputs and the roll demand of each vehicle, and has the rate of every message. The
    libraries: pymavlink, of .bin with the message types that ours reads; pyulog with all topics; mcap with all messages
    in file order, undecoded.
    """
    rows = []
    for path in logs:
        size = path.stat().st_size / 1e6
        for reader in (ours, READERS[path.suffix.lower()]):
            count = reader(str(path))
            seconds = min(repeat(partial(reader, str(path)), number=1, repeat=3))
            speeds = {"MB/s": size / seconds, "messages/s": count / seconds}
            rows.append({"file": path.name, "by": reader.__name__, "s": seconds, **speeds})
    show(pd.DataFrame(rows))


def fleet(logs: tuple[Path, ...]) -> None:
    """What logs cost a fleet: CPU seconds for the rows and the page of each, by format and tier, on one core."""
    stay_in_this_process()
    threadpool_limits(limits=1, user_api="blas")
    rows_of_log(logs[0], "", flight_page)  # which loads the libraries
    rows = []
    for path in logs:
        began = time.process_time()
        kind = f"{path.suffix.lower()}, no flight"
        with suppress(Unreadable):
            if tier := best_tier(rows_of_log(path, path.name, flight_page)[0]):
                kind = f"{path.suffix.lower()}, tier {tier}"
        rows.append({"logs": kind, "CPU s": time.process_time() - began})
    table = pd.DataFrame(rows)
    spent = pd.concat([table, table.assign(logs="all")]).groupby("logs")["CPU s"]
    show(spent.agg(["size", "mean", "median", "max"]).reset_index())
    print(f"\nAt most {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB.")


SECONDS = 30.0
PORT = 14598


def send(rate: float) -> None:
    """Flies a hover live: attitude and motor outputs at ``rate`` Hz each."""
    rates = dict.fromkeys(("ATTITUDE", "SERVO_OUTPUT_RAW"), rate)
    stream = {"autopilot": "ardupilot", "only_when_asked": True, "rates": rates}
    scenario = scenario_of({"duration": SECONDS, "stream": stream})
    with closing(Ground("127.0.0.1", PORT)) as ground:
        fly_live(scenario, Simulation(scenario), ground, 1.0, lambda _: None)


def over_udp(rate: float, folder: Path) -> dict[str, Any]:
    """A row of half a minute at a rate, Hz."""
    link = Link(f"udpin:127.0.0.1:{PORT}")
    path = folder / f"{rate:.0f}.rrd"
    vehicle = multiprocessing.get_context("spawn").Process(target=send, args=(rate,))
    with (
        closing(Dashboard("a hover", "roll", path, False, None)) as dashboard,
        LearningProcess() as executor,
    ):
        shown = dashboard.open, dashboard.report, list[object]().append
        recording = RawRecording(path.with_suffix(".tlog"))
        session = LiveSession(link, LiveStream(), Settings(), *shown, executor, recording)
        vehicle.start()
        while session.status.vehicle is None:
            session.step()
        clocks = time.thread_time, time.process_time, time.monotonic
        began = [clock() for clock in clocks]
        run(session, lambda: not vehicle.is_alive(), None, 5.0, lambda *_: "")
        main, process, spent = (clock() - at for clock, at in zip(clocks, began, strict=True))
    link.close()
    now = session.status
    row = {"Hz": rate, "rows": now.learned + now.shown, "lost": now.lost}
    latency = zip(("median", "99th percentile", "longest"), now.latency, strict=True)
    row |= {f"{name}, ms": 1e3 * seconds for name, seconds in latency}
    return row | {"main thread, of a core": main / spent, "process": process / spent}


def live() -> None:
    """The cost of `mavdem live`: latency from a datagram's arrival to its estimate, and CPU time.

    Arrival is as the kernel stamps it. A simulated flight is sent by another process over UDP for half a minute;
    dashboard and raw stream are recorded.
    """
    with TemporaryDirectory() as folder:
        rates = (50.0, 100.0, 200.0, 400.0)
        show(pd.DataFrame([over_udp(rate, Path(folder)) for rate in rates]))


def show(table: pd.DataFrame) -> None:
    print(table.to_string(index=False, float_format="{:,.3g}".format))


@click.command(help=__doc__)
@click.argument("what", type=click.Choice(["read", "fleet", "live"]))
@click.argument("logs", nargs=-1, type=click.Path(exists=True, dir_okay=False, path_type=Path))
def main(what: str, logs: tuple[Path, ...]) -> None:
    if what == "live":
        live()
    else:
        {"read": read, "fleet": fleet}[what](logs)


if __name__ == "__main__":
    main()
