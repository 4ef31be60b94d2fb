"""Recordings of flights in the library, made on request; or the fact (a coded finding) why there is none.

Writing them takes as long as everything else that is done for a log, and few are ever opened. The column
``recording_stage`` of a flight's entry has its state: empty before anybody asks and when the files are there, then
waiting, a stage of the work, or failed. A request is stored in the index, so that it outlives the server, and is worked
on by the threads and processes that read logs, within the same limits. Two requests for a flight are one.
"""

import json
import os
import shutil
from pathlib import Path

from mavdem.assessment.assess import assess_recording
from mavdem.assessment.identity import identify_vehicle
from mavdem.dataset.signals import Signals
from mavdem.errors import Refusal, Unreadable, error_message
from mavdem.facts import Fact
from mavdem.facts.fleet import ReadingFact
from mavdem.facts.serve import RefusalReason, Stage
from mavdem.fleet.workers import JobOutcome, LogRows
from mavdem.ingest.telemetry import Log, Telemetry
from mavdem.processes import lower_priority
from mavdem.results import (
    MODEL_FILE,
    RECORDING_FILE,
    RECORDINGS,
    REPORT_FILE,
    possible_recordings,
    write_recordings,
)
from mavdem.serve.index import DIGEST_GLOB, LibraryEntry, entry_from_row
from mavdem.serve.library import Library
from mavdem.serve.reading import LOWER_PRIORITY, ProgressFile, read_stored_log
from mavdem.serve.stored_files import PROGRESS, RESULTS, UNFINISHED_RECORDINGS


def reason_without_file(entry: LibraryEntry, name: str) -> Fact:
    """Explains to a client why a flight of the library does not have the file that was requested.

    Args:
        entry: index entry of the flight.
        name: name of the file.

    Returns:
        The reason as a fact (coded finding): the log is still being read, or the file is a recording (which shows a
        model) and no model was learned from the log; otherwise that there is no such file.
    """
    if not entry.is_done:
        return Fact(RefusalReason.STILL_BEING_READ, name=entry.name)
    # Only a log that is stored in the library has a digest. Of others, which `mavdem track` has read, the files of
    # results are not known.
    is_stored = bool(entry.digest)
    was_read_here = is_stored and entry.stage == Stage.DONE
    lacks_model = was_read_here and MODEL_FILE not in entry.file_names
    if name in RECORDINGS and lacks_model:
        return Fact(RefusalReason.NO_RECORDING, name=name)
    # Also where there is a model, but no package is installed that writes this recording.
    return Fact(RefusalReason.NO_SUCH_FILE, name=name)


class RecordingRequests:
    """The requests for recordings of flights of a library, for all threads of one server."""

    def __init__(self, library: Library) -> None:
        """Takes the library, whose index has the requests."""
        self._library = library

    def missing_names(self, entry: LibraryEntry) -> list[str]:
        """Returns the names of the recordings of a flight that can be made and do not exist yet."""
        folder = self._library.results_folder(entry)
        names = [name for name in entry.file_names if name in RECORDINGS]
        return [name for name in names if not (folder / name).is_file()]

    def request(self, entry: LibraryEntry) -> LibraryEntry:
        """Queues the making of a flight's recordings, unless they exist, are queued already or are being made.

        Recordings that failed before are tried again.

        Args:
            entry: index entry of the flight.

        Returns:
            Its entry, with the state of its recordings.

        Raises:
            Refusal: the flight has no recordings, its log is not kept, or there is no room for them.
        """
        has_recordings = any(name in RECORDINGS for name in entry.file_names)
        # The log is found by the digest of its content. An entry whose log is not kept has none.
        is_log_kept = bool(entry.digest)
        if entry.stage != Stage.DONE or not has_recordings or not is_log_kept:
            raise Refusal(reason_without_file(entry, RECORDING_FILE))
        if not self.missing_names(entry):
            return entry
        # The size of the recordings is not known yet, so only the quota and the reserve of the disk are checked.
        self._library.check_space(0)
        with self._library.transaction() as db:
            # Recordings that wait or are made already keep their stage.
            db.execute(
                """update entries set recording_stage = ?, recording_problem = '' where id = ?
                and recording_stage in ('', ?)""",
                [Stage.WAITING, entry.id, Stage.FAILED],
            )
        return self._library.entry(entry.id)

    def claim(self) -> LibraryEntry | None:
        """Claims requested recordings of a flight: marks them as being made by this server.

        Returns:
            The entry of the flight; None if no recordings are requested.
        """
        with self._library.transaction() as db:
            # A single statement, so that no other server can claim the same entry in between. The pattern excludes
            # entries whose log is not kept.
            row = db.execute(
                """update entries set recording_stage = ?, claimed = ? where id =
                (select id from entries where recording_stage = ? and digest glob ? limit 1)
                returning *""",
                [Stage.READING, self._library.name, Stage.WAITING, DIGEST_GLOB],
            ).fetchone()
        return None if row is None else entry_from_row(row)

    def give_back(self, entry: LibraryEntry) -> None:
        """Lets claimed recordings wait again, since they cannot be made now."""
        self._library.change(entry.id, recording_stage=Stage.WAITING, claimed="")

    def finish(self, entry: LibraryEntry, outcome: JobOutcome) -> None:
        """Stores in the index whether the recordings of a flight could be made, and how large its results are now.

        If the flight was deleted meanwhile, its files are removed.

        Args:
            entry: the flight, as it was claimed.
            outcome: outcome of the work; if it failed, the status of its first row is the reason.
        """
        results_folder = self._library.results_folder(entry)
        shutil.rmtree(_unfinished_folder(results_folder), ignore_errors=True)
        columns = {"claimed": "", "recording_stage": "", "recording_problem": ""}
        if self.missing_names(entry):
            reason = outcome.rows[0].status if outcome.rows else ""
            columns |= {"recording_stage": Stage.FAILED, "recording_problem": str(reason)}
        kept_bytes = 0
        if results_folder.is_dir():
            kept_bytes = sum(path.stat().st_size for path in results_folder.iterdir())
        try:
            self._library.change(entry.id, kept=kept_bytes, **columns)
        except Refusal as error:
            if error.fact.code is not RefusalReason.NO_SUCH_FLIGHT:
                raise
            self._library.remove_files_of_deleted_log(entry)

    def stage(self, entry: LibraryEntry) -> str:
        """Returns the progress of a flight's recordings, a value of ``Stage``; empty if nobody has requested them."""
        if not self.missing_names(entry):
            return Stage.DONE
        if entry.recording_stage in ("", Stage.WAITING, Stage.FAILED):
            return entry.recording_stage
        return str(self._library.progress(entry).get("stage", entry.recording_stage))


def make_recordings(path: Path, key: str, page: object) -> LogRows:
    """Makes the recordings of a log of the library; a ``ReadLog`` function for worker processes.

    The log is read and its model learned again, since storing all that the recordings show would take more disk space
    than the log. The recordings appear in the folder of results when both are complete.

    Args:
        path: path of the log, ``FOLDER/logs/DIGEST/NAME``.
        key: key of its content, which is not used.
        page: maker of a page, which is not used.

    Returns:
        No rows and no pages.

    Raises:
        Unreadable: the log cannot be read, no model can be learned from it, or there is no room for the files.
    """
    lower_priority(LOWER_PRIORITY)
    # FOLDER is two levels above the folder of the log.
    results = path.parents[2] / RESULTS / path.parent.name
    unfinished_folder = _unfinished_folder(results)
    shutil.rmtree(unfinished_folder, ignore_errors=True)
    unfinished_folder.mkdir()
    try:
        progress = ProgressFile(unfinished_folder / PROGRESS)
        progress.report(Stage.READING)
        log = read_stored_log(path)
        telemetry = vehicle_of_page(log, results / REPORT_FILE)
        progress.report(Stage.LEARNING)
        assessment = assess_recording(log, Signals(telemetry), progress=progress.show_step)
        progress.report(Stage.RECORDING)
        paths = {name: unfinished_folder / name for name in possible_recordings()}
        write_recordings(paths, assessment)
        for name, unfinished_path in paths.items():
            if unfinished_path.is_file():
                os.replace(unfinished_path, results / name)
    except OSError as error:
        raise Unreadable(ReadingFact.RECORDINGS_NOT_WRITTEN, reason=error_message(error)) from None
    finally:
        shutil.rmtree(unfinished_folder, ignore_errors=True)
    return LogRows(rows=[], pages={})


def _unfinished_folder(results: Path) -> Path:
    """Returns the folder in which recordings are made, by the folder of the results."""
    return results.with_name(f".{results.name}{UNFINISHED_RECORDINGS}")


def vehicle_of_page(log: Log, document_path: Path) -> Telemetry:
    """Returns the vehicle of a log that the page of its flight shows.

    Args:
        log: a log with at least one vehicle.
        document_path: path of the document that was written with the page, which names the vehicle.
    """
    if len(log.vehicles) == 1:
        return log.vehicles[0]
    identity = json.loads(document_path.read_bytes())["identity"]
    for telemetry in log.vehicles:
        candidate = identify_vehicle(Signals(telemetry))
        if (candidate.system, candidate.name) == (identity["system"], identity["name"]):
            return telemetry
    return log.vehicles[0]
