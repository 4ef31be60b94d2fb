"""Kept outcomes are those that would be found anew, and are found anew where anything of them has changed."""

from __future__ import annotations

from dataclasses import replace

import kept
import numpy as np
import pytest
from simulated import simulated

from mavdem import Flight
from mavdem.comparison import METHODS, dem, judge
from mavdem.dem import Settings
from mavdem.windows import windows

FLIGHT = simulated(samples=520, wind=2.0)
WINDOWS = windows("made up", FLIGHT, train=300, test=60, hop=80)
SETTINGS = Settings(window=9, parameter_precision=1.0)
DEM, ARX = dem("DEM", SETTINGS), next(method for method in METHODS if method.name == "ARX(2)")


@pytest.fixture(scope="module", autouse=True)
def in_this_process():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("mavdem.dem.many.spare_cores", lambda: 1)
        yield


@pytest.fixture
def found_anew(monkeypatch):
    """Methods and starts of what was not kept, of one call after the other."""
    calls: list[tuple[str, int]] = []

    def outcomes(cut, methods, executor):
        for window in cut:
            for method in methods:
                calls.append((method.name, window.start))
                yield judge(method, window)

    monkeypatch.setattr(kept, "outcomes", outcomes)
    return calls


def outcomes(folder, cut=WINDOWS, methods=(DEM, ARX)):
    found = {(one.method, one.start): one for one in kept.kept_outcomes(folder, cut, methods)}
    assert set(found) == {(method.name, window.start) for window in cut for method in methods}
    return found


def files(folder):
    return [path for path in folder.rglob("*") if path.is_file()]


@pytest.mark.slow
def test_kept_outcomes_are_the_fresh_ones(tmp_path, found_anew):
    assert len(WINDOWS) == 3
    outcomes(tmp_path / "deep" / "er")
    assert len(found_anew) == len(files(tmp_path)) == 6
    again = outcomes(tmp_path / "deep" / "er")
    assert len(found_anew) == 6
    for method in (DEM, ARX):
        for window in WINDOWS:
            fresh, one = judge(method, window), again[method.name, window.start]
            assert one.to_dict() | {"seconds": 0} == fresh.to_dict() | {"seconds": 0}
            np.testing.assert_array_equal(one.forecast, fresh.forecast)
            assert (one.band is None) == (fresh.band is None) == (method is ARX)
            if method is DEM:
                np.testing.assert_array_equal(one.expected, fresh.expected)
                np.testing.assert_array_equal(one.band, fresh.band)


def test_without_the_double_they_come_from_the_comparison(tmp_path):
    found = outcomes(tmp_path, WINDOWS[:1], [ARX])
    assert found["ARX(2)", 0].to_dict() | {"seconds": 0} == judge(ARX, WINDOWS[0]).to_dict() | {"seconds": 0}


def test_a_changed_setting_is_worked_out_anew_and_the_rest_is_kept(tmp_path, found_anew):
    outcomes(tmp_path, WINDOWS[:2])
    found_anew.clear()
    changed = dem("DEM", replace(SETTINGS, parameter_precision=1.0000000001))
    outcomes(tmp_path, WINDOWS[:2], [changed, ARX])
    assert found_anew == [("DEM", 0), ("DEM", 80)]
    outcomes(tmp_path)
    assert found_anew[2:] == [("DEM", 160), ("ARX(2)", 160)]


@pytest.mark.parametrize(
    "changed",
    [
        lambda flight: Flight(flight.time, flight.inputs, np.nextafter(flight.outputs, np.inf)),
        lambda flight: Flight(flight.time, np.nextafter(flight.inputs, np.inf), flight.outputs),
        lambda flight: Flight(flight.time, flight.inputs, flight.outputs, output_names=("pitch", "pitch rate")),
    ],
)
def test_other_numbers_are_another_window(tmp_path, found_anew, changed):
    outcomes(tmp_path, WINDOWS[:1], [ARX])
    outcomes(tmp_path, windows("made up", changed(FLIGHT), train=300, test=60, hop=80)[:1], [ARX])
    assert found_anew == [("ARX(2)", 0)] * 2


def test_other_source_is_worked_out_anew_by_the_methods_that_run_it(tmp_path, found_anew, monkeypatch):
    outcomes(tmp_path, WINDOWS[:1])
    digest, version = kept.digest, kept.version
    with monkeypatch.context() as patch:
        patch.setattr(kept, "digest", lambda *modules: digest(*modules) + str("mavdem.dem.learn" in modules))
        outcomes(tmp_path, WINDOWS[:1], [DEM])
    assert found_anew[2:] == [("DEM", 0)]
    with monkeypatch.context() as patch:
        patch.setattr(kept, "version", lambda name: version(name) + ".1" * (name == "scipy"))
        outcomes(tmp_path, WINDOWS[:1])
    assert found_anew[3:] == [("DEM", 0), ("ARX(2)", 0)]
    outcomes(tmp_path, WINDOWS[:1])
    assert len(found_anew) == 5


@pytest.mark.parametrize(
    "damage",
    [
        lambda content: b"",
        lambda content: content[:100],
        lambda content: content[:-1],
        lambda content: content[:-9] + bytes([content[-9] ^ 1]) + content[-8:],
        lambda content: b"not an outcome at all" * 9,
    ],
)
def test_a_damaged_file_is_worked_out_anew_and_mended(tmp_path, found_anew, damage):
    outcomes(tmp_path, WINDOWS[:1], [ARX])
    (file,) = files(tmp_path)
    whole = file.read_bytes()
    file.write_bytes(damage(whole))
    for _ in range(2):
        found = outcomes(tmp_path, WINDOWS[:1], [ARX])
        assert found["ARX(2)", 0].forecast is not None
    assert found_anew == [("ARX(2)", 0)] * 2
    assert len(file.read_bytes()) == len(whole) and files(tmp_path) == [file]


def test_a_folder_that_cannot_be_written_is_told(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError):
        outcomes(tmp_path / "file")
