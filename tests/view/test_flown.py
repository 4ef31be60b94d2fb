"""The recording of a simulated flight: what is drawn is where the vehicle was, and what is plotted is what it did."""

from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from made_up_motion import made_up_motion
from rerun.chunk import RrdReader
from rerun_file import chunks

from mavdem.view.flown import Pose, _plots, write_pose

MOTION = made_up_motion()
ROTORS = 0.2 * np.array([[1.0, 1.0], [-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0]])


def pose(**instead) -> Pose:
    columns = {field.name: getattr(MOTION, field.name) for field in fields(Pose) if field.name != "rotors"}
    return Pose(**(columns | instead), rotors=ROTORS)


@pytest.fixture(scope="module")
def columns(tmp_path_factory: pytest.TempPathFactory):
    """By entity path, what was sent over time by component, and the time, s."""
    path: Path = tmp_path_factory.mktemp("flown") / "flight.rrd"
    write_pose(path, "made up", pose())
    assert len(RrdReader(path).blueprints()) == 1
    found: dict[str, dict[str, np.ndarray]] = {}
    for name, chunk, batch in chunks(path):
        if "boot clock" not in chunk.timeline_names:
            continue
        own = {part.split(":")[-1]: batch.column(part).to_pylist() for part in batch.schema.names if ":" in part}
        own["time"] = np.array(batch.column("boot clock").cast("int64")) / 1e9
        found.setdefault(f"/{name}", {}).update(own)
    return found


@pytest.mark.slow
def test_the_vehicle_is_where_it_was_and_turned_as_it_was(columns):
    here, vehicle = columns["/world/here"], columns["/world/here/vehicle"]
    rows = np.searchsorted(MOTION.time, here["time"] - 1e-6)
    assert len(rows) == pytest.approx(50 * 20, abs=2)
    np.testing.assert_allclose(np.array(here["translation"])[:, 0], MOTION.position[rows], atol=1e-6)
    x, y, z, w = np.array(vehicle["quaternion"])[:, 0].T
    np.testing.assert_allclose(np.column_stack([w, x, y, z]), MOTION.attitude[rows], atol=1e-6)


def test_thrust_points_up_and_the_wind_at_the_vehicle(columns):
    thrust = np.array(columns["/world/here/vehicle/thrust"]["vectors"])
    assert thrust.shape[1:] == (4, 3) and (thrust[..., 2] < 0).all() and not thrust[..., :2].any()
    wind = columns["/world/here/wind"]
    vectors, origins = (np.array(wind[name])[:, 0] for name in ("vectors", "origins"))
    assert (vectors[:, 1] < 0).all()
    heads = origins + vectors
    assert (heads[:, 1] > 0.2).all() and np.allclose(heads[:, [0, 2]], 0)


def test_lines_are_what_was_flown_and_errors_what_was_not_known(columns):
    assert np.ravel(columns["/roll/0 roll"]["scalars"]).max() == pytest.approx(np.degrees(0.2), abs=0.1)
    for name in ("0 roll rate", "1 roll"):
        np.testing.assert_array_equal(np.ravel(columns[f"/errors/{name}"]["scalars"]), 0.0)
    late = np.abs(MOTION.time - MOTION.time[pose().carries()][-1]) < 0.1  # what touch-down does is not in the range
    assert np.ptp(_plots(pose(known_rates=MOTION.known_rates + 9.0 * late[:, None]))[2].range) < 1.0
    for n, place in enumerate(("front right", "rear left", "front left", "rear right")):
        beyond = np.ravel(columns[f"/motors/{n} {place}"]["scalars"])
        np.testing.assert_allclose(beyond, MOTION.outputs[:, n] - MOTION.outputs.mean(axis=1), atol=1e-9)


def test_a_flight_that_never_takes_off_and_a_name_that_is_no_text(tmp_path):
    still = pose(armed=np.zeros(len(MOTION), dtype=bool), rotor_speeds=np.zeros((len(MOTION), 4)), wind=0 * MOTION.wind)
    write_pose(tmp_path / "still.rrd", "\udcff", still)
    assert (tmp_path / "still.rrd").stat().st_size > 1000
