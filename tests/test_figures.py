"""Figures of whole flights beside those of before: a sign, a unit or a threshold that changes shows in some of them.

``--write-golden`` writes them, to be compared before they are kept.
"""

import json
from collections import defaultdict
from pathlib import Path
from statistics import fmean, pstdev

from command_line import run, strict_json
from pytest import approx, mark
from recorded_flights import shared

GOLDEN = Path(__file__).parent / "golden"
MANY = 6  # of more numbers, their count, mean, deviation and ends stand for all
DIGITS = 5
PRECISION = 0.01
REVIEW = ("review",)
FLIGHTS = {
    "real/logs/sitl_hexa_plus_motor6_lost.bin": REVIEW,
    "real/logs/yaw_twist_16_percent.BIN": REVIEW,
    "real/logs/px4_motor_failure.ulg": REVIEW,
    "real/propeller/hover_cut20mm_1.BIN": REVIEW,
    "real/logs/ardupilot_range_1075_1920_slow.tlog": REVIEW,
    "real/logs/crash_motor2_mechanical.bin": REVIEW,
    "real/logs/crash_motor4_at_its_limit.BIN": REVIEW,
    "real/logs/crash_errors_without_time.BIN": REVIEW,
    "real/logs/ardupilot_motor2_at_its_limit.BIN": REVIEW,
    "samples/ardupilot_wind5_steps.tlog": ("review", "tune"),
    "real/logs/px4_default_rates_learnable.ulg": ("review", "tune"),
    "real/logs/gains_named_before_34.BIN": ("review", "tune", "twin"),
    "sitl_raw/ap_sid.BIN.xz": ("review", "tune"),
}
OPTIONS = {"review": ["--out", "out"], "tune": ["--axis", "all"], "twin": []}


def figures(document):
    """All numbers and codes of a document by their keys, whatever their places in lists."""
    found = defaultdict(list)

    def collect(value, key):
        if isinstance(value, dict):
            for name in value.keys() - {"units"}:
                collect(value[name], f"{key}.{name}")
        elif isinstance(value, list):
            for part in value:
                collect(part, key)
        elif isinstance(value, float | int) or key.endswith(("code", "level")):
            found[key].append(value)

    collect(document, "")
    return {key: summary(found[key]) for key in sorted(found)}


def summary(values):
    """Few ``values`` as they are; of many numbers, what stands for them."""
    if len(values) <= MANY or isinstance(values[0], str):
        return [
            float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value for value in values
        ]
    return summary([len(values), fmean(values), pstdev(values), values[0], values[-1]])


@mark.slow
@mark.parametrize("log, commands", FLIGHTS.items())
def test_the_figures_of_a_flight_are_those_of_before(
    log, commands, tmp_path, monkeypatch, capsys, request
):
    path = GOLDEN / f"{Path(log).stem}.json"
    flight = shared(log)
    monkeypatch.chdir(tmp_path)
    now = {}
    for command in commands:
        assert run(command, flight, *OPTIONS[command], "--json") == 0
        document = strict_json(capsys.readouterr().out)
        now |= {command + key: values for key, values in figures(document).items()}
    if request.config.getoption("--write-golden"):
        path.parent.mkdir(exist_ok=True)
        path.write_text(json.dumps(now, indent=0))
    before = json.loads(path.read_text())
    assert now.keys() == before.keys()
    assert not {key: (before[key], now[key]) for key in now if not near(now[key], before[key])}


def near(now, before):
    """Whether codes are the same, and numbers but for what processors round in their own ways."""
    if isinstance(before[0], str):
        return now == before
    return now == approx(before, rel=PRECISION, abs=1e-7)
