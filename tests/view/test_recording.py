from __future__ import annotations

import subprocess
import sys
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray
from rerun.chunk import RrdReader
from rerun_file import chunks, views
from scipy.linalg import expm
from scipy.stats import norm

import mavdem
from mavdem.evaluate import held_out_test
from mavdem.report.blocks import markdown
from mavdem.report.screen import screen, title
from mavdem.view import show, write_recording
from mavdem.view.lines import ITERATIONS_A_SECOND
from mavdem.view.series import output_series, prior_outweighs_data

DT = 0.01


def flight(samples: int = 400) -> mavdem.Flight:
    """A roll loop of second order with four motors, driven by their differences and by wind of 0.1 s."""
    rng = np.random.default_rng(1)
    motors = 1600 + 20 * np.cumsum(rng.normal(size=(samples, 4)), axis=0) / 10
    torque = (motors - motors.mean(axis=0)) @ [-0.1, 0.1, 0.1, -0.1]
    wind = np.convolve(rng.normal(size=samples + 40), np.exp(-0.5 * np.linspace(-2, 2, 41) ** 2), "valid")
    transition = expm(np.array([[0.0, 1.0], [-9.0, -4.0]]) * DT)
    state, outputs = np.zeros(2), []
    for push in torque + wind:
        outputs.append(state)
        state = transition @ state + [0.0, push * DT]
    return mavdem.Flight(
        50.0 + DT * np.arange(samples),
        motors,
        np.array(outputs) + 1e-4 * rng.normal(size=(samples, 2)),
        input_names=tuple(f"motor {i} (somewhere)" for i in range(1, 5)),
        input_units=("µs",) * 4,
        output_names=("roll", "roll rate"),
        output_units=("rad", "rad/s"),
        provenance={"source": "made-up.tlog"},
    )


TRAIN, TEST = flight()[:300], flight()[300:400]


def write(path: Path, learned: mavdem.Learned) -> None:
    write_recording(path, [TRAIN], learned, held_out_test(TRAIN, TEST, learned))


@pytest.fixture(scope="module")
def learned() -> mavdem.Learned:
    return mavdem.learn(
        TRAIN,
        mavdem.Settings(
            order=2, window=9, parameter_precision=0.1, output_groups=(0, 1), state_groups=(0, 1), iterations=5
        ),
    )


@pytest.fixture(scope="module")
def recording(learned: mavdem.Learned, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("view") / "flight.rrd"
    write(path, learned)
    return path


def lines(path: Path) -> dict[str, tuple[dict[str, np.ndarray], np.ndarray]]:
    """Times by timeline, in s or iterations, and values of every line in a recording, by entity path."""
    found = {}
    for name, chunk, batch in chunks(path):
        if "Scalars:scalars" not in batch.schema.names:
            continue
        assert f"/{name}" not in found, "one chunk a line"
        times = {timeline: np.array(batch.column(timeline).cast("int64")) for timeline in chunk.timeline_names}
        if "flight time" in times:
            times["flight time"] = times["flight time"] / 1e9
        found[f"/{name}"] = times, np.array(batch.column("Scalars:scalars").to_pylist())
    return found


def document(path: Path) -> str:
    texts = [
        chunk.to_record_batch().column("TextDocument:text").to_pylist()
        for chunk in RrdReader(path).stream()
        if str(chunk.entity_path) == "/result"
    ]
    assert len(texts) == 1
    return str(texts[0][0][0])


def test_rerun_finds_the_file_sound(recording: Path) -> None:
    check = [sys.executable, "-m", "rerun", "rrd", "verify", str(recording)]
    done = subprocess.run(check, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(("column", "name"), list(enumerate(TRAIN.output_names)))
def test_outputs_are_those_of_flight_and_model_in_degrees(
    recording: Path, learned: mavdem.Learned, column: int, name: str
) -> None:
    drawn = lines(recording)
    before, after = TRAIN.time - TRAIN.time[0], TEST.time - TRAIN.time[0]
    ahead, half = learned.forecast(TEST.inputs)[:, [column]], learned.forecast_band(TEST.inputs, 0.9)[:, [column]]
    expected = {
        "measured": (before, TRAIN.outputs[:, [column]]),
        "dem_one_step": (before, learned.one_step()[:, [column]]),
        "dem_forecast": (after, ahead),
        "constant_mean": (after, np.full((len(TEST), 1), TRAIN.outputs[:, column].mean())),
        "band": (after, np.hstack([ahead - half, ahead + half])),
    }
    for line, (time, values) in expected.items():
        times, shown = drawn[f"/outputs/{name}/{line}"]
        if len(times["flight time"]) == len(time) + 1:  # a gap after each window
            times, shown = {"flight time": times["flight time"][:-1]}, shown[:-1]
        np.testing.assert_allclose(times["flight time"], time, atol=1e-8)
        np.testing.assert_allclose(shown, np.degrees(values), rtol=1e-12)


def test_motors_and_process_noise_are_in_the_units_of_flight_and_model(
    recording: Path, learned: mavdem.Learned
) -> None:
    drawn = lines(recording)
    for i, name in enumerate(TRAIN.input_names):
        np.testing.assert_array_equal(drawn[f"/inputs/{name}"][1][:, 0], TRAIN.inputs[:, i])
    places, noise = learned.process_noise()
    for i, name in enumerate(("roll", "roll rate")):
        times, values = drawn[f"/process_noise/{name}"]
        np.testing.assert_allclose(times["flight time"], DT * places, atol=1e-8)
        np.testing.assert_allclose(values[:, 0], noise[:, i], rtol=1e-12)


def test_parameters_move_with_their_bands_and_the_known_ones_stand_apart(
    recording: Path, learned: mavdem.Learned
) -> None:
    drawn = lines(recording)
    half = norm.ppf(0.95) * learned.learning.theta_sd
    names = [f"A/{row} from {column}" for row in TRAIN.output_names for column in TRAIN.output_names]
    names += [f"B/{row} from {column}" for row in TRAIN.output_names for column in TRAIN.input_names]
    names += [f"C/{row} from {column}" for row in TRAIN.output_names for column in TRAIN.output_names]
    free = {"A/roll rate from roll", "A/roll rate from roll rate"}
    free |= {f"B/roll rate from {motor}" for motor in TRAIN.input_names}
    for i, name in enumerate(names):
        root = f"/parameters/{'free' if name in free else 'known_beforehand'}/{name}"
        times, mean = drawn[f"{root}/mean"]
        assert times["iteration"].tolist() == list(range(len(learned.free_energy)))
        np.testing.assert_allclose(times["flight time"], times["iteration"] / ITERATIONS_A_SECOND, atol=1e-8)
        theta = learned.learning.theta[:, i]
        np.testing.assert_allclose(mean[:, 0], theta, rtol=1e-12)
        np.testing.assert_allclose(drawn[f"{root}/band"][1], np.stack([theta - half[:, i], theta + half[:, i]], -1))


def test_everything_is_free_under_a_prior_that_knows_nothing(tmp_path: Path) -> None:
    path = tmp_path / "flight.rrd"
    write(path, mavdem.learn(TRAIN, mavdem.Settings.paper()))
    parameters = [line for line in lines(path) if line.startswith("/parameters/") and line.endswith("/mean")]
    assert len(parameters) == 2 * 2 + 2 * 4 + 2 * 2
    assert all(line.startswith("/parameters/free/") for line in parameters)


def test_free_energy_and_noise_precisions_are_those_of_every_iteration(
    recording: Path, learned: mavdem.Learned
) -> None:
    drawn = lines(recording)
    np.testing.assert_allclose(drawn["/free_energy/total"][1][:, 0], learned.free_energy.total)
    terms = {name: drawn[f"/free_energy/terms/{name}"][1][:, 0] for name in learned.free_energy.terms}
    for name, term in learned.free_energy.terms.items():
        np.testing.assert_allclose(terms[name], term - term[-1], atol=1e-9)
    total = learned.free_energy.total
    np.testing.assert_allclose(sum(terms.values()), total - total[-1], atol=1e-6)
    for i, name in enumerate(("z of roll", "z of roll rate", "w of roll", "w of roll rate")):
        mean = drawn[f"/noise_precisions/{name}/mean"][1][:, 0]
        np.testing.assert_allclose(mean, learned.learning.lambda_[:, i], rtol=1e-12)


def test_one_precision_for_all_outputs_and_one_for_all_states_are_named_so(tmp_path: Path) -> None:
    path = tmp_path / "flight.rrd"
    learned = mavdem.learn(TRAIN, mavdem.Settings(order=2, window=9, parameter_precision=0.1))
    write(path, learned)
    drawn = lines(path)
    for i, name in enumerate(("z, measurement", "w, process")):
        mean = drawn[f"/noise_precisions/{name}/mean"][1][:, 0]
        np.testing.assert_allclose(mean, learned.learning.lambda_[:, i], rtol=1e-12)


def test_a_precision_that_the_prior_fixes_is_distinguished_from_one_that_is_learnt(learned: mavdem.Learned) -> None:
    # One λ for each of two outputs and two states; the default prior is sure of measurement noise only.
    assert prior_outweighs_data(learned).tolist() == [True, True, False, False]
    sure = mavdem.learn(TRAIN, replace(learned.settings, lambda_w_precision=1e10))
    assert prior_outweighs_data(sure).tolist() == [True] * 4


def test_states_of_a_free_c_are_no_outputs_and_have_no_unit(tmp_path: Path) -> None:
    path = tmp_path / "flight.rrd"
    write(path, mavdem.learn(TRAIN, mavdem.Settings.paper()))
    assert {line for line in lines(path) if line.startswith("/process_noise/")} == {
        "/process_noise/state 1",
        "/process_noise/state 2",
    }


def test_a_forecast_beyond_all_numbers_leaves_the_measured_in_sight(learned: mavdem.Learned, tmp_path: Path) -> None:
    class Unstable(mavdem.Learned):
        def forecast_every(self, steps: int, inputs: ArrayLike, outputs: ArrayLike) -> NDArray[np.float64]:
            away = super().forecast_every(steps, inputs, outputs) * np.exp(np.linspace(0, 700, len(TEST)))[:, None]
            away[-3:] = [[np.inf, -np.inf], [np.nan, np.nan], [1.0, 1.0]]
            return away

    unstable = Unstable(**{field.name: getattr(learned, field.name) for field in fields(learned)})
    write(tmp_path / "flight.rrd", unstable)
    assert "| infinite |" in document(tmp_path / "flight.rrd")
    for output in output_series([TRAIN], unstable, held_out_test(TRAIN, TEST, unstable)):
        low, high = output.range
        assert low < output.measured.min() and high > output.measured.max()
        # Not the 1e300 of the forecast; what the numbers on the axis need is more than the quarters on each side.
        assert high - low < 5 * np.ptp(output.measured)


def test_the_result_in_words_is_the_screen(recording: Path, learned: mavdem.Learned) -> None:
    held_out = held_out_test(TRAIN, TEST, learned)
    assert document(recording) == markdown([title([TRAIN]), *screen(learned, held_out)])


def test_the_one_blueprint_in_the_file_shows_lines_that_are_there(recording: Path) -> None:
    shown = views(recording)
    assert len(shown) == 13
    entities = [*lines(recording), "/result"]
    for origin in shown:
        assert any(f"{entity}/".startswith(f"/{origin}/") for entity in entities), f"the view of {origin} is empty"


def test_a_write_that_fails_leaves_what_was_there(
    tmp_path: Path, learned: mavdem.Learned, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "flight.rrd"
    path.write_bytes(b"an earlier recording")

    def fails(*_: object) -> str:
        raise RuntimeError("the summary fails")

    monkeypatch.setattr("mavdem.view.recording.screen", fails)
    with pytest.raises(RuntimeError, match="the summary fails"):
        write(path, learned)
    assert path.read_bytes() == b"an earlier recording"
    assert [file.name for file in tmp_path.iterdir()] == ["flight.rrd"]


def test_without_a_screen_show_says_so(monkeypatch: pytest.MonkeyPatch, recording: Path) -> None:
    monkeypatch.setattr(sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    assert "no screen" in show(recording)


def test_the_viewer_is_named_as_this_shell_finds_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    scripts = tmp_path / "environment" / "bin"
    scripts.mkdir(parents=True)
    (scripts / "rerun").touch(mode=0o755)
    monkeypatch.setattr(sys, "executable", str(scripts / "python"))
    monkeypatch.setenv("PATH", "/nowhere")
    monkeypatch.chdir(tmp_path)
    assert "`environment/bin/rerun flight.rrd`" in show("flight.rrd")
    monkeypatch.chdir(scripts)
    assert f"`{scripts}/rerun flight.rrd`" in show("flight.rrd")
    monkeypatch.setenv("PATH", str(scripts))
    assert "`rerun flight.rrd`" in show("flight.rrd")
