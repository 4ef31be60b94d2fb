"""The examples of docs/fleet.md run on a fleet, and the page names columns that there are."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from tracked_logs import make_logs, track

from mavdem.fleet.dataset import read_rows, write_rows
from mavdem.fleet.row import FlightRow, row_schema

PAGE = (Path(__file__).parents[2] / "docs" / "fleet.md").read_text()
FLIGHT = {"vehicle": "7", "axis": "roll", "motors": ("1", "2"), "trim_share": (1.1, 0.9), "health_reason": "Motor 1."}


def test_the_examples_answer(tmp_path, monkeypatch, capsys):
    make_logs(tmp_path / "logs", 1, "damaged")
    track(tmp_path / "fleet", tmp_path / "logs")
    flown = [
        FlightRow(file=f"{day}.bin", date=f"2026-11-0{day}", health=health, **FLIGHT)
        for day, health in ((1, "ok"), (2, "fault"))
    ]
    write_rows(tmp_path / "fleet", [*read_rows(tmp_path / "fleet"), *flown])
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    examples = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    for code in examples:
        exec(code, names)
    assert len(examples) == 3
    assert names["found"] == [("7", "fault", "Motor 1.", 2)]
    assert names["shares"]["trim_share"].to_list() == [1.1, 0.9] * 2
    assert "It is damaged." in capsys.readouterr().out


def test_the_page_names_columns_that_there_are():
    table = PAGE.partition("| column | what it is |")[2].partition("\n\n")[0]
    named = set(re.findall(r"`([a-z]\w+)`", " ".join(line.split("|")[1] for line in table.splitlines() if line)))
    columns = set(row_schema().names)
    assert named <= columns
    derived = {name for name in columns if re.search(r"_(interval|status|error)$|^residual_|^mean_|^balance_", name)}
    assert columns - named <= derived
