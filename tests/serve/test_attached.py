"""A server that is attached to a link: the page of the session, and its log in the library."""

import socket
import time

from command_line import FLIGHT
from serving import serving

from mavdem.ingest import read_log
from mavdem.serve import attached
from mavdem.serve.attached import Attached
from mavdem.serve.library import Library

FRAMES = FLIGHT.read_bytes()[:200_000]


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def test_a_session_has_a_page_and_leaves_its_log(tmp_path, monkeypatch):
    monkeypatch.setattr(attached, "PAGE_SECONDS", 0.1)
    monkeypatch.setattr(attached, "SILENT_PAGES", 5)
    library = Library(tmp_path)
    come = []
    port = free_port()
    live = Attached(f"udpin:127.0.0.1:{port}", library, lambda: come.append(True))
    live.start()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle:
        for first in range(0, len(FRAMES), 1000):
            vehicle.sendto(FRAMES[first : first + 1000], ("127.0.0.1", port))
            time.sleep(0.001)
    while not come:  # it is silent
        time.sleep(0.05)
    assert f"udpin:127.0.0.1:{port}" in live.page and "1:1" in live.page
    live.stop()
    (entry,), _ = library.find("1", [], 10)
    (telemetry,) = read_log(library.path_of(entry)).vehicles
    assert entry.name.endswith(".tlog") and (telemetry.system, telemetry.component) == (1, 1)
    with serving(tmp_path / "other") as server:
        assert (
            server.ask("GET", "/live").status == 404 and "/live" not in server.ask("GET", "/").text
        )
