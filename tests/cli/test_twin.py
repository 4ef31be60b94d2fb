"""A twin does in every simulator what the vehicle did, and flies other parameters, or says why not."""

import json
import re
import tomllib
from contextlib import redirect_stdout
from io import StringIO

import numpy as np
from command_line import run
from pytest import approx, fixture, mark

from mavdem.ingest import read_log

pytestmark = mark.slow

WEIGHT = 1.52 * 9.81 / 4


@fixture(scope="module")
def folder(tmp_path_factory, coarse_physics):
    """A folder with a simulated flight, and the twin of its vehicle in all file formats."""
    folder_path = tmp_path_factory.mktemp("twin")
    log = folder_path / "flight.tlog"
    files = [folder_path / f"mine.{ending}" for ending in ("toml", "json", "params", "sdf")]
    assert run("fly", "iris_identification", "--duration", "31", "--out", log) == 0
    arguments = [
        "twin",
        log,
        "--mass",
        "1.52",
        *(word for file in files for word in ("--out", str(file))),
    ]
    with redirect_stdout(StringIO()) as output:
        assert run(*arguments, "--json") == 0
    (folder_path / "said.json").write_text(output.getvalue())
    return folder_path


def test_every_file_hovers_and_rolls_as_the_vehicle(folder):
    """Each format has its own formula of thrust and torque: all must give the true hover and roll effect."""
    body = tomllib.loads((folder / "mine.toml").read_text())["vehicle"]["body"]
    hover = body["hover"]
    arm = body["arm"][1]
    inertia = body["inertia"][0]
    frame = json.loads((folder / "mine.json").read_text())
    rows = re.findall(r"(\w+)\t([-\d.e]+)\t9", (folder / "mine.params").read_text())
    rows += re.findall(r"<(\w+)>([-\d.e]+)</", (folder / "mine.sdf").read_text())
    sih = {name: float(value) for name, value in rows}
    lift = sih["motorConstant"] * sih["maxRotVelocity"] ** 2  # Gazebo's, N at full command
    # Thrust in hover by formula, and what a share of the command adds to it; PX4's curve is linear here.
    assert [sih["SIH_T_MAX"] * hover, lift * hover**2] == approx([WEIGHT, WEIGHT], rel=1e-3)
    assert frame["hoverThrOut"] == approx(hover, rel=1e-3)
    effects = [
        arm * WEIGHT / hover / inertia,
        sih["SIH_L_ROLL"] * sih["SIH_T_MAX"] / sih["SIH_IXX"],
        frame["diagonal_size"] / 8**0.5 * WEIGHT / hover / frame["moment_inertia"][0],
        arm * 2 * lift * hover / sih["ixx"],
    ]
    with np.load(folder / "flight.truth.npz") as truth:
        true = 1000 * abs(truth["roll_effect"]).mean()
        assert body["hover"] == approx((truth["trim"][0] - 1000) / 1000, abs=0.01)
    assert effects == approx([true] * 4, rel=0.1)
    assert effects == approx([effects[0]] * 4, rel=1e-3)


def test_the_twin_follows_the_recorded_setpoints_much_as_the_vehicle_did(folder):
    alike = json.loads((folder / "said.json").read_text())["alike"]
    assert list(alike) == ["roll", "pitch", "yaw"]
    for axis, compared in alike.items():
        assert np.abs(compared["levels"]).max() < 1.5  # Levels are in dB.
        names = ("sway", "rate") if axis != "yaw" else ("rate",)
        for name in names:
            assert compared[name][1] == approx(compared[name][0], rel=0.1), (axis, name)


@mark.parametrize(
    "change, sentence",
    [
        ("MC_ROLLRATE_P=0.1", ""),
        ("MC_ROLRATE_P=0.1", "the autopilot has no 'MC_ROLRATE_P' here: similar: MC_ROLLRATE_P"),
        ("MC_ROLLRATE_P=-1", "vehicle.parameters.MC_ROLLRATE_P must be from 0 to 10000, not -1"),
    ],
)
def test_the_twin_flies_other_gains_or_gives_the_reason_why_not(
    folder, change, sentence, tmp_path, capsys
):
    """A gain is changed by its name; a wrong name or value is refused."""
    (gains := tmp_path / "gains.param").write_text("MC_PITCH_P 7\n")
    flown = tmp_path / "flown.tlog"
    arguments = ["calm", "--duration", "16", "--vehicle", folder / "mine.toml", "--params", gains]
    code = run("fly", *arguments, "--out", flown, "--set", "IMU_GYRO_CUTOFF=30", "--set", change)
    assert code == (2 if sentence else 0)
    assert sentence in capsys.readouterr().err
    expected = {"MC_PITCH_P": 7, "IMU_GYRO_CUTOFF": 30}
    if code == 0:
        assert expected.items() <= read_log(flown).vehicles[0].parameters.items()
