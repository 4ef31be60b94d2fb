"""Reading a log for the library, in a worker process: its rows for the fleet, and the folder of results.

The folder is made beside its place and moved there whole. Meanwhile a file in it says how far the work is, and what is
known of the log so far, for those who watch.
"""

import json
import os
import shutil
from contextlib import chdir
from dataclasses import replace
from pathlib import Path
from typing import Any

from mavdem.assessment import Assessment
from mavdem.assessment.assess import assess_signals
from mavdem.assessment.limits import LEVELS_BY_SEVERITY
from mavdem.containers import JsonValues
from mavdem.dataset.signals import Signals
from mavdem.documents import whole
from mavdem.documents.review import review_document
from mavdem.errors import Unreadable
from mavdem.facts.events import Reported
from mavdem.facts.fleet import Reading
from mavdem.facts.serve import Stage
from mavdem.files import atomic_write
from mavdem.fleet.row import FlightRows
from mavdem.fleet.rows_of_log import rows_of_assessment
from mavdem.fleet.store import open_store
from mavdem.fleet.tracking import assess_rows
from mavdem.fleet.workers import LogRows
from mavdem.ingest import read_log
from mavdem.ingest.vocabulary import CONTROL_PARAMETERS
from mavdem.report.pages.flight_page import review_page
from mavdem.results import PAGE_FILE, result_files, write_result_files
from mavdem.serve.library import PROGRESS, RESULTS, columns_of


def read_for_library(path: Path, key: str, page: object) -> LogRows:
    """Returns the rows of a log, whose results are then in their folder; raises ``Unreadable``."""
    os.setpriority(os.PRIO_PROCESS, 0, 5)  # pages come first
    results = path.parents[2] / RESULTS
    digest = path.parent.name
    made = results / f".{digest}"
    shutil.rmtree(made, ignore_errors=True)
    made.mkdir()
    told = JsonValues()

    def tell(stage: Stage, **columns: Any) -> None:
        told.update(columns, stage=stage)
        with atomic_write(made / PROGRESS) as file:
            file.write(json.dumps(told).encode())

    tell(Stage.READING)
    with chdir(path.parent):  # where the server has its logs is nobody's business
        log = read_log(path.name)
    if not log.vehicles:
        raise Unreadable(Reading.NO_VEHICLE)
    judged = []
    for telemetry in log.vehicles:
        tell(Stage.JUDGING)
        assessment = assess_signals(log, Signals(telemetry))
        tell(Stage.LEARNING, **_judgement(assessment))
        flown = rows_of_assessment(assessment.with_axis("pitch"), log.source)
        judged.append((assessment, flown))
    # Of several vehicles the page is of the worst that flew; those of the others are beside it.
    judged.sort(
        key=lambda both: (both[1][0].has_flight, LEVELS_BY_SEVERITY.index(both[0].headline.level)),
        reverse=True,
    )
    (assessment, _), *others = judged
    rows = [row for _, rows_of_vehicle in judged for row in rows_of_vehicle]
    page_name = f"{RESULTS}/{digest}/{PAGE_FILE}"
    tell(Stage.DRAWING, **_told(assessment, rows))
    names = result_files(assessment)
    files = {name: name for name in names}
    for other, (row, *_) in others:
        name = f"vehicle_{row.system}_{row.component}.html"
        files[name] = name
        (made / name).write_text(review_page(other), "utf-8", "replace")
    document = whole("review", review_document(assessment) | {"files": files})
    places = {name: made / name for name in names}
    write_result_files(places, json.dumps(document, indent=1, allow_nan=False), assessment)
    shutil.rmtree(results / digest, ignore_errors=True)  # of an earlier time
    os.replace(made, results / digest)
    return [replace(row, page=page_name) for row in rows], {}


def _judgement(assessment: Assessment) -> dict[str, str]:
    return {
        "headline": str(assessment.headline),
        "level": str(assessment.headline.level),
        "next_step": str(assessment.next_step),
        **{name: str(fact.level) for name, fact in assessment.lights.items()},
    }


def _told(assessment: Assessment, rows: FlightRows) -> JsonValues:
    """What the index has of a log."""
    assert assessment.evidence is not None
    signals = assessment.evidence.signals
    parameters = signals.telemetry.parameters
    gains = {name: value for name, value in parameters.items() if CONTROL_PARAMETERS.match(name)}
    changes = (event for event in assessment.events if event.code is Reported.MODE_CHANGED)
    modes = dict.fromkeys(event.subject for event in changes)
    return {
        **columns_of(rows),
        **_judgement(assessment),
        "modes": ",".join(modes),
        "gains": json.dumps(gains),
    }


def publish(path: Path, key: str, page: object) -> LogRows:
    """Judges the vehicles of the library of a server, whose lock is at ``path``, anew, and writes the fleet's table."""
    with open_store(path.parents[1]) as store:
        store.publish(assess_rows)
    return [], {}
