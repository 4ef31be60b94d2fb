#!/usr/bin/env python
"""How `mavdem serve` bears a load; prints a Markdown table.

Usage: tools/bench/serve.py list             # 10,000 flights listed and searched
       tools/bench/serve.py load LOG         # 50 uploads by 10 clients while 20 read pages
       tools/bench/serve.py kill LOG         # kill -9 twenty times in mid-upload and mid-work
"""

from __future__ import annotations

import hashlib
import http.client
import json
import os
import random
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from statistics import quantiles
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import click

from mavdem.facts.serve import Stage
from mavdem.serve.library import Entry, Library, insert

BOUNDARY = "boundary"
PATIENCE_SECONDS = 600.0


class Served(NamedTuple):
    """A running server."""

    process: subprocess.Popen[bytes]
    port: int

    def ask(self, method: str, path: str, body: bytes | None = None) -> tuple[int, bytes]:
        kind = {"Content-Type": f"multipart/form-data; boundary={BOUNDARY}"}
        line = http.client.HTTPConnection("127.0.0.1", self.port, timeout=60)
        with closing(line):
            line.request(method, path, body, kind if body else {})
            answer = line.getresponse()
            return answer.status, answer.read()

    def flights(self, search: str = "", limit: int = 1000) -> Any:
        return json.loads(self.ask("GET", f"/api/flights?q={search}&limit={limit}")[1])

    @property
    def megabytes(self) -> float:
        """Of the process that answers, now."""
        text = Path(f"/proc/{self.process.pid}/status").read_text()
        return int(text.split("VmRSS:")[1].split()[0]) / 1024


@contextmanager
def served(folder: Path, jobs: int = 2) -> Iterator[Served]:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = int(probe.getsockname()[1])
    words = ["serve", str(folder), "--port", str(port), "--no-browser", "--jobs", str(jobs)]
    process = subprocess.Popen([sys.executable, "-m", "mavdem", *words], stderr=subprocess.DEVNULL)
    server = Served(process, port)
    try:
        until(lambda: server.ask("GET", "/static/serve.js")[0] == 200)
        yield server
    finally:
        process.terminate()
        process.wait()


def until(holds: Callable[[], bool]) -> None:
    """Waits until something holds."""
    began = time.perf_counter()
    while time.perf_counter() - began < PATIENCE_SECONDS:
        with suppress(OSError, http.client.HTTPException):
            if holds():
                return
        time.sleep(0.05)
    raise TimeoutError


def form(name: str, content: bytes) -> bytes:
    head = f'Content-Disposition: form-data; name="filearg"; filename="{name}"'
    return f"--{BOUNDARY}\r\n{head}\r\n\r\n".encode() + content + f"\r\n--{BOUNDARY}--\r\n".encode()


def other(content: bytes, number: int) -> bytes:
    """The same log with other bytes: what follows a tlog's last message is not read."""
    return content + number.to_bytes(8, "big")


def report(rows: list[tuple[str, str]]) -> None:
    print("| what | figure |\n|---|---|")
    for name, figure in rows:
        print(f"| {name} | {figure} |")


def percentiles(seconds: list[float]) -> str:
    hundredths = quantiles(seconds, n=100)
    return f"{1e3 * hundredths[49]:.0f} ms, p99 {1e3 * hundredths[98]:.0f} ms"


@click.group()
def bench() -> None:
    """Benchmarks of the server."""


@bench.command("list")
def list_command() -> None:
    """Lists and searches 10,000 flights."""
    chance = random.Random(1)
    with TemporaryDirectory() as place:
        library = Library(Path(place))
        with library._transaction() as db:
            for number in range(10_000):
                entry = Entry(
                    f"{number:022}",
                    f"flight_{number}.bin",
                    digest=f"{number:064}",
                    path=f"logs/{number}",
                    stage=Stage.DONE,
                    vehicle=f"quad-{number % 50}",
                    sorted_by=f"2026-{1 + number % 12:02}-{1 + number % 28:02}T10:00:00",
                    wind_speed=chance.uniform(0, 12),
                    gains=json.dumps({f"ATC_RAT_RLL_{one}": chance.random() for one in "PID"}),
                    motors=chance.choice(("good", "watch", "bad")),
                    words=f"flight_{number}.bin quad-{number % 50} little margin",
                )
                insert(db, entry)
        library.close()
        figures = []
        with served(Path(place)) as server:
            for search in ("", "quad-7", "motors:bad%20wind%3E5", "ATC_RAT_RLL_P%3E0.9", "nothing"):
                seconds = []
                for _ in range(30):
                    began = time.perf_counter()
                    status, _ = server.ask("GET", f"/?q={search}")
                    seconds.append(time.perf_counter() - began)
                    assert status == 200
                total = server.flights(search)["total"]
                figures.append((f"page of `{search}`: {total} found", percentiles(seconds)))
    report(figures)


@bench.command("load")
@click.argument("log", type=click.Path(path_type=Path))
def load_command(log: Path) -> None:
    """Uploads and reads pages at the same time."""
    content = log.read_bytes()
    with TemporaryDirectory() as place, served(Path(place)) as server:
        server.ask("POST", "/api/logs", form(log.name, content))
        until(lambda: server.flights("stage:done")["total"] == 1)
        page = f"/f/{server.flights()['flights'][0]['id']}"
        pages = list[float]()
        wrong = list[int]()
        is_over = False

        chance = random.Random(1)

        def read() -> None:
            while not is_over:
                for path in ("/", page):
                    began = time.perf_counter()
                    status, _ = server.ask("GET", path)
                    pages.append(time.perf_counter() - began)
                    wrong.extend([status] * (status != 200))
                    time.sleep(chance.uniform(0.0, 1.0))

        def upload(number: int) -> None:
            body = form(f"{number}.tlog", other(content, number))
            status, _ = server.ask("POST", "/api/logs", body)
            wrong.extend([status] * (status != 201))

        began = time.perf_counter()
        with ThreadPoolExecutor(20) as readers, ThreadPoolExecutor(10) as clients:
            for _ in range(20):
                readers.submit(read)
            list(clients.map(upload, range(50)))
            most = server.megabytes
            until(lambda: server.flights("stage:done")["total"] == 51)
            took = time.perf_counter() - began
            most = max(most, server.megabytes)
            is_over = True
    report(
        [
            ("a page, 20 readers", f"{percentiles(pages)} of {len(pages)}"),
            ("answers that were errors", str(len(wrong))),
            ("the most memory of the server", f"{most:.0f} MB"),
            ("the 50 logs were read in", f"{took:.0f} s, {50 / took:.1f} a second"),
        ]
    )


@bench.command("kill")
@click.argument("log", type=click.Path(path_type=Path))
@click.option("--times", default=20)
def kill_command(log: Path, times: int) -> None:
    """Kills the server again and again, and counts what it had acknowledged."""
    content = log.read_bytes()
    chance = random.Random(1)
    acknowledged = set[str]()
    with TemporaryDirectory() as place:
        folder = Path(place)
        for number in range(times):
            with served(folder) as server, ThreadPoolExecutor(4) as clients:

                def upload(mine: int, server: Served = server) -> None:
                    body = other(content, mine)
                    with suppress(OSError, http.client.HTTPException):
                        status, _ = server.ask("POST", "/api/logs", form(f"{mine}.tlog", body))
                        if status == 201:
                            acknowledged.add(hashlib.sha256(body).hexdigest())

                for mine in range(4):
                    clients.submit(upload, 4 * number + mine)
                time.sleep(chance.uniform(0.0, 3.0 if number % 2 else 0.05))
                os.kill(server.process.pid, signal.SIGKILL)
        with served(folder) as server:
            total = server.flights()["total"]
            until(lambda: server.flights("stage:done")["total"] == total)
        there = {path.name for path in (folder / "logs").iterdir()}
    report(
        [
            ("uploads that were acknowledged", str(len(acknowledged))),
            ("of them lost", str(len(acknowledged - there))),
        ]
    )


if __name__ == "__main__":
    bench()
