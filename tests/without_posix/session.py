"""What people do with mavdem: a review, a fleet in two processes, a live link, and a server with an upload.

Usage: session.py LOG FOLDER. It runs with any Python in which mavdem is installed, without the packages of tests, and
fails where a step does. The LOG is too slow for a model.
"""

import gc
import importlib
import json
import pkgutil
import shutil
import signal
import socket
import sys
import threading
import time
import traceback
import urllib.request
from pathlib import Path

import mavdem
import sitl_scenarios
from mavdem.cli.commands import main
from mavdem.machine import free_port

DEADLINE_SECONDS = 240
"""s in which an upload must have been read, on a machine that is busy with other tests."""


def import_all():
    """The modules that cannot be imported, with the reason."""
    failures = {}
    for package in (mavdem, sitl_scenarios):
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            try:
                importlib.import_module(module.name)
            except Exception as error:
                failures[module.name] = repr(error)
    return failures


def frames(log):
    """The frames of a tlog, whose records are 8 bytes of time and a frame."""
    content = log.read_bytes()
    place = 8
    while place < len(content):
        overhead = 12 if content[place] == 0xFD else 8
        end = place + overhead + content[place + 1]
        yield content[place:end]
        place = end + 8


def is_taken(port):
    """Whether a program listens at a port of UDP."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(("127.0.0.1", port))
        except OSError:
            return True
    return False


def fly_live(log, folder):
    """Listens to the frames of a log, records them, and returns the exit code."""
    port = free_port()

    def send():
        while not is_taken(port):
            time.sleep(0.05)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle:
            for number, frame in enumerate(frames(log)):
                vehicle.sendto(frame, ("127.0.0.1", port))
                if number % 10 == 0:
                    time.sleep(0.002)

    threading.Thread(target=send).start()
    words = ["live", f"udpin:127.0.0.1:{port}", "--duration", "3", "--plain"]
    return main([*words, "--record", str(folder / "live.tlog"), "--rrd", str(folder / "live.rrd")])


def serve(log, folder):
    """Serves a library, uploads a log under a name that Windows reserves, and returns its page and the exit code."""
    port = free_port()
    address = f"http://127.0.0.1:{port}"
    pages = []

    def visit():
        try:
            pages.append(visited_page(address, log))
        except Exception:
            pages.append(traceback.format_exc())
        signal.raise_signal(signal.SIGINT)

    threading.Thread(target=visit).start()
    words = ["serve", str(folder / "library"), "--port", str(port), "--no-browser", "--jobs", "1"]
    code = main(words)
    return pages[0], code


def visited_page(address, log):
    """The page of an uploaded log, once it is there."""
    end = time.monotonic() + DEADLINE_SECONDS
    body = (
        b'--x\r\nContent-Disposition: form-data; name="filearg"; filename="aux.tlog"\r\n\r\n'
        + log.read_bytes()
        + b"\r\n--x--\r\n"
    )
    headers = {"Content-Type": "multipart/form-data; boundary=x"}
    while time.monotonic() < end:
        try:
            urllib.request.urlopen(address).close()
            break
        except OSError:
            time.sleep(0.1)
    upload = urllib.request.Request(f"{address}/api/logs", body, headers)
    with urllib.request.urlopen(upload) as answer:
        (flight,) = json.load(answer)["flights"]
    while time.monotonic() < end:
        with urllib.request.urlopen(f"{address}/api/flights/{flight['id']}") as answer:
            stage = json.load(answer)["flight"]["stage"]
        if stage in ("done", "failed"):
            break
        time.sleep(0.2)
    with urllib.request.urlopen(f"{address}/f/{flight['id']}") as answer:
        return f"{stage} {answer.status} {answer.read().decode()[:20]}"


def run(log, folder):
    # What is imported stays: to search it for garbage again and again would take a fifth of the time.
    gc.disable()
    failures = import_all()
    gc.freeze()
    gc.enable()
    assert not failures, failures
    logs = folder / "two logs"
    logs.mkdir()
    for name in ("a b.tlog", "ü.tlog"):
        shutil.copy(log, logs / name)
    assert main(["review", str(logs / "ü.tlog"), "--out", str(folder / "review ü")]) == 0
    assert main(["track", str(logs), "--out", str(folder / "fleet"), "--jobs", "2"]) == 0
    # No model comes, which the exit code 1 says.
    assert fly_live(log, folder) == 1
    assert (folder / "live.tlog").stat().st_size > log.stat().st_size // 2
    page, code = serve(log, folder)
    assert page.lower().startswith("done 200 <!doctype"), page
    assert code == 0


if __name__ == "__main__":
    run(Path(sys.argv[1]), Path(sys.argv[2]))
