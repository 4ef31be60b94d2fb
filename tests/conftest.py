"""What holds for every test."""

import faulthandler
import gc
import os
import pickle
import re
from contextlib import closing, nullcontext
from dataclasses import fields, is_dataclass
from functools import cache
from hashlib import sha256
from pathlib import Path
from time import time
from unittest.mock import Mock

from filelock import FileLock
from hypothesis import settings
from pytest import Module, MonkeyPatch, fixture, hookimpl, register_assert_rewrite

TESTS = Path(__file__).parent
START_TIME = time()
"""When this process began, in seconds of the clock of files."""
HYPOTHESIS_FOLDER = Path(os.environ.get("HYPOTHESIS_STORAGE_DIRECTORY", ".hypothesis"))
FLIGHTS_FOLDER = os.environ.get("SIMULATED_FLIGHTS_DIRECTORY")
"""Where simulated flights are kept for the next run of the tests; None where they are not."""
CONSTANTS_ARE_STORED = (HYPOTHESIS_FOLDER / "constants").is_dir()
"""Whether an earlier run has stored the constants that Hypothesis collects."""

# Its assertions show the figures that differ, as those of a test do.
register_assert_rewrite("golden_figures")
# What is imported and collected stays, and the collector would walk over it again and again: a quarter of the start.
gc.disable()
# Read when NumPy and SciPy are imported, here and in every process that a test starts: for small matrices more threads
# only wait for each other.
os.environ["OPENBLAS_NUM_THREADS"] = "1"
# Else pymavlink knows no extension fields until it has read a frame that has some.
os.environ["MAVLINK20"] = "1"
# Screens are as wide here as where nobody has set a width, whatever the terminal of who runs the tests.
os.environ.pop("COLUMNS", None)


def pytest_addoption(parser):
    """Golden files hold a whole screen each: ``--write-golden`` writes them anew, to be read before they are kept."""
    parser.addoption(
        "--write-golden", action="store_true", help="write the golden files of tests/report anew"
    )
    parser.addoption(
        "--in-full",
        action="store_true",
        help="also run validations, compare figures of many more flights and all pictures, check all logs",
    )


FILE_MARKS = re.compile(r"^pytestmark = (.*)$", re.MULTILINE)
"""The marks that all tests of a file have."""


def runs_validations(config):
    """Returns whether tests with the mark ``in_full`` are run: on request, and where golden files are written anew."""
    return config.option.in_full or config.option.write_golden


def marks_left_out(config):
    """Returns the marks whose tests this run leaves out: ``["in_full"]``, for example."""
    marks = [] if runs_validations(config) else ["in_full"]
    return [*marks, "slow"] if config.option.markexpr == "not slow" else marks


def pytest_ignore_collect(collection_path, config):
    """Returns True for a file whose tests are all left out: each worker would import it for nothing.

    Returns None, which leaves the choice to pytest, for all others.
    """
    if collection_path.suffix != ".py":
        return None
    file_marks = FILE_MARKS.findall(collection_path.read_text("utf-8"))
    are_left_out = any(f"mark.{mark}" in str(file_marks) for mark in marks_left_out(config))
    return True if are_left_out else None


def one_at_a_time(config, name, *, is_stored):
    """Lets only one process of a run at a time do what has this name, where there are several.

    All collect the same tests in the same order. In a new checkout each would compile the same files, for some seconds
    of a processor. So the others wait for the first, and read what it has written. What is stored since an earlier run
    is read by all at once.
    """
    if is_stored or "PYTEST_XDIST_WORKER" not in os.environ:
        return nullcontext()
    # The folder of a process is in that of the run.
    path = Path(config.option.basetemp).with_name(f"{name}.lock")
    return FileLock(path).acquire(poll_interval=0.02)


def was_compiled(path):
    """Returns whether an earlier run has compiled a file of tests as it is now, and so most of what it imports."""
    compiled_files = (path.parent / "__pycache__").glob(f"{path.stem}.*.pyc")
    compile_times = [compiled.stat().st_mtime for compiled in compiled_files]
    return any(path.stat().st_mtime < compile_time < START_TIME for compile_time in compile_times)


@hookimpl(wrapper=True)
def pytest_make_collect_report(collector):
    """Imports the tests of a file, which compiles them and what they import."""
    if not isinstance(collector, Module):
        return (yield)
    name = sha256(collector.nodeid.encode()).hexdigest()
    with one_at_a_time(collector.config, name, is_stored=was_compiled(collector.path)):
        return (yield)


@hookimpl(wrapper=True)
def pytest_collection_modifyitems(config, items):
    """Puts files of this folder first: they have some of the longest tests, of all figures, pictures and texts.

    At the end one worker would run them while the others have nothing left. Hypothesis collects the constants of all
    modules, as values to try, and keeps them in files.
    """
    with one_at_a_time(config, "constants", is_stored=CONSTANTS_ARE_STORED):
        result = yield
    items.sort(key=lambda item: item.path.parent != TESTS)
    leave_out_validations(config, items)
    return result


def leave_out_validations(config, items):
    """Removes the tests with the mark ``in_full`` from ``items`` unless this run runs validations."""
    if runs_validations(config):
        return
    validations = {item for item in items if item.get_closest_marker("in_full")}
    items[:] = [item for item in items if item not in validations]
    config.hook.pytest_deselected(items=[*validations])


def pytest_collection_finish():
    gc.freeze()
    # By default the collector runs after every 700 new objects, of which a flight makes millions.
    gc.set_threshold(50_000, 20, 20)
    gc.enable()


# A busy machine may take long over an example, and every run tries the same ones; the rest is as hypothesis has it.
settings.register_profile("without deadline", settings(), deadline=None, derandomize=True)
settings.load_profile("without deadline")


HANGING_SECONDS = 400.0  # A limit for one test, however busy the machine is.


@hookimpl(wrapper=True)
def pytest_runtest_protocol():
    """Ends the process of a test that hangs, as where Rerun never answers: no exception reaches it there."""
    faulthandler.dump_traceback_later(HANGING_SECONDS, exit=True)
    try:
        return (yield)
    finally:
        faulthandler.cancel_dump_traceback_later()


@fixture
def here(tmp_path, monkeypatch):
    """An empty folder, which is the current one."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@fixture(scope="module")
def without_wind_fits():
    """For tests of other things: a learner that follows the wind spends half its time on physical parameters."""
    with MonkeyPatch.context() as patch:
        patch.setattr("mavdem.plant.online_wind_torque.FIRST_FIT_SECONDS", 1e9)
        yield


@fixture(scope="module")
def without_watchdog():
    """For tests of other things: the watchdog judges all messages twice a second."""
    with MonkeyPatch.context() as patch:
        for step in ("begin_review", "finish_review"):
            patch.setattr(f"mavdem.live.watchdog.Watchdog.{step}", Mock(return_value=()))
        yield


@fixture(scope="module")
def without_alarms(without_watchdog):
    """For tests of rows: a live stream spends a quarter of its time on alarms, of the watchdog and of weak motors."""
    with MonkeyPatch.context() as patch:
        patch.setattr("mavdem.live.motor_alarms.MotorAlarms.add_sample", Mock(return_value=()))
        yield


@fixture
def without_pages(monkeypatch):
    """For tests that read no page: those that their commands write are empty, since to draw one takes seconds."""
    for drawing in ("report.pages.flight_page.review_page", "cli.tune.tune_page"):
        monkeypatch.setattr(f"mavdem.{drawing}", Mock(return_value=""))


@fixture(scope="module")
def coarse_physics():
    """Makes the simulator use long time steps, 5 ms, for tests whose flights need not be exact."""
    with MonkeyPatch.context() as patch:
        patch.setattr("sitl_scenarios.dynamics.MAX_STEP_SECONDS", 5e-3)
        patch.setattr("sitl_scenarios.gyro.MAX_SAMPLING_PERIOD", 5e-3)
        yield


READERS = ("cli.sources", "results", "wind_velocity.from_log", "fleet.rows_of_log")
"""Modules whose ``read_log`` reads the logs that commands name."""
USERS_OF_SIGNALS = (
    "cli.sources",
    "cli.learn",
    "cli.info",
    "assessment.assess",
    "results",
    "wind_velocity.from_log",
)
"""Modules that derive the signals of a log for commands."""


@fixture
def logs_read_once(monkeypatch):
    """For a test with several commands of one log: it is read once, and what is derived of its signals is kept."""
    from mavdem.dataset.signals import Signals
    from mavdem.ingest import read_log

    logs = {}
    caches = {}

    def read_once(path):
        status = os.stat(path)
        key = os.fspath(path), status.st_mtime_ns, status.st_size
        if key not in logs:
            logs[key] = read_log(path)
        return logs[key]

    def signals_with_cache(telemetry, *arguments, **options):
        # What is derived of one vehicle is never taken for that of another. Each is kept, so that no other has its id.
        _, cache = caches.setdefault(id(telemetry), (telemetry, {}))
        return Signals(telemetry, *arguments, cache=cache, **options)

    for module in READERS:
        monkeypatch.setattr(f"mavdem.{module}.read_log", read_once)
    for module in USERS_OF_SIGNALS:
        monkeypatch.setattr(f"mavdem.{module}.Signals", signals_with_cache)


def values_of(argument):
    """What an argument was made of: the fields of a dataclass, without what it has computed since."""
    if is_dataclass(argument):
        return [getattr(argument, field.name) for field in fields(argument)]
    return argument


def once(fit, folder):
    """The same fit, done once in a run of the tests for the same arguments.

    Args:
        fit: function of arguments that can be pickled, without a side effect.
        folder: where results are kept for the other processes of this run.
    """
    from mavdem.immutable import freeze
    from sitl_scenarios import dynamics

    results = {}

    def fitted(*arguments, **options):
        # With ``coarse_physics`` the same flight is another one.
        values = (dynamics.MAX_STEP_SECONDS, *map(values_of, arguments), *options.items())
        key = sha256(pickle.dumps((fit.__qualname__, values))).hexdigest()
        path = folder / key
        if key not in results and path.is_file():
            # Arrays that are read-only are written, but come back writeable.
            results[key] = freeze(pickle.loads(path.read_bytes()))
        if key not in results:
            results[key] = fit(*arguments, **options)
            # Another process finds no file, or a whole one.
            unfinished = path.with_name(f"{key}.{os.getpid()}")
            unfinished.write_bytes(pickle.dumps(results[key]))
            unfinished.replace(path)
        return results[key]

    return fitted


@fixture(scope="session")
def run_folder(tmp_path_factory):
    """A folder that all processes of a run share."""
    # All processes of a run have folders below that of the run.
    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent
    folder = folder / "once"
    folder.mkdir(exist_ok=True)
    return folder


@fixture(scope="session")
def browser(tmp_path_factory):
    """A browser, which all tests of this process share."""
    from browsing import Browser

    with closing(Browser(tmp_path_factory.mktemp("chromium"))) as browser:
        yield browser


@fixture(scope="session")
def once_in_a_run(run_folder):
    """Makes a function one whose result for the same arguments is computed once in a run: a flight, for example."""
    return lambda function: once(function, run_folder)


@fixture(scope="session", autouse=True)
def one_process():
    """Tests run on all cores already: what they run starts no processes only to share its work.

    A copy of the process of a test has large memory, and its results stay unknown to the tests that follow. Tests of
    these processes say that there are two cores.
    """
    with MonkeyPatch.context() as patch:
        patch.setattr("mavdem.dem.parallel.available_workers", lambda: 1)
        yield


@fixture(scope="session", autouse=True)
def frozen_modules():
    """What was collected stays frozen, although a live session unfreezes all objects at its end.

    Otherwise each later session would walk over all modules at its start, for a quarter of a second of a processor.
    """
    with MonkeyPatch.context() as patch:
        patch.setattr("gc.freeze", Mock())
        patch.setattr("gc.unfreeze", Mock())
        yield


@fixture(scope="session", autouse=True)
def fits_once(once_in_a_run):
    """Many tests, and many commands of a test, ask for the same fits and simulations of a flight."""
    from mavdem.loops import advice, step_response, twin_flight
    from mavdem.loops import identification as in_flight
    from mavdem.plant import estimation
    from mavdem.wind_velocity import estimation as wind_estimation

    with MonkeyPatch.context() as patch:
        for module, name in (
            (estimation, "_estimate_parameters"),
            (in_flight, "identify_axis"),
            (advice, "_next_step"),
            (step_response, "estimate_impulse_response"),
            (twin_flight, "_simulated_motion"),
            (wind_estimation, "identify_drag"),
        ):
            patch.setattr(module, name, once_in_a_run(getattr(module, name)))
        yield


@fixture(scope="session", autouse=True)
def flights_once(run_folder):
    """Many tests fly the same scenarios, and so does every run."""
    from stored_flights import stored_simulation_of

    folder = Path(FLIGHTS_FOLDER or run_folder / "flights")
    with MonkeyPatch.context() as patch:
        patch.setattr("sitl_scenarios.simulation.simulation_of", stored_simulation_of(folder))
        yield


@fixture(scope="session", autouse=True)
def sample_logs_once():
    """Forty tests read the same telemetry log of the repository: each process of the run does so once."""
    from recorded_flights import LOGS

    from mavdem.ingest import tlog

    read_tlog = tlog.read_tlog

    @cache
    def read_sample_log(name, target):
        return read_tlog(name)

    def read(name):
        # A log has the name by which it was read, which may be that of a link.
        target = Path(name).resolve()
        if target.parent == LOGS.resolve():
            return read_sample_log(name, target)
        return read_tlog(name)

    with MonkeyPatch.context() as patch:
        patch.setattr(tlog, "read_tlog", read)
        yield
