"""A higher cut-off of the gyro's filter is advised where its phase lag takes the margin and the noise allows it."""

from dataclasses import replace

from made_up_loop import made_up
from pytest import approx, mark

from mavdem.facts.loops import GainFact
from mavdem.loops.axis_loops import MARGIN_TARGETS
from mavdem.loops.demand_noise import DemandNoise
from mavdem.loops.gyro_cutoff import MAX_DEMAND_NOISE, gyro_cutoff_advice


def advised_with_noise(monkeypatch, loop, noise):
    """Returns the advice for a loop whose demand has so much noise of the gyro."""
    measured = None if noise is None else DemandNoise(30.0, 80.0, noise, noise, 0.0, 1.0)
    monkeypatch.setattr("mavdem.loops.gyro_cutoff.demand_noise", lambda *_: measured)
    return gyro_cutoff_advice([loop], MARGIN_TARGETS["default"])


@mark.parametrize(
    "cutoff, noise, is_advised",
    [
        (15.0, 1e-4, True),
        # Twice the cut-off may pass four times the noise.
        (15.0, 0.3 * MAX_DEMAND_NOISE, False),
        (15.0, None, False),
        # The filter costs little phase.
        (80.0, 1e-4, False),
    ],
)
def test_the_cut_off_is_raised_if_it_takes_the_margin_and_noise_allows_it(
    monkeypatch, cutoff, noise, is_advised
):
    loop = made_up().with_parameters({"IMU_GYRO_CUTOFF": cutoff})
    loop = replace(loop, plant=loop.plant._replace(filtered=False))
    advice = advised_with_noise(monkeypatch, loop, noise)
    assert (advice is not None) == is_advised
    if advice is not None:
        assert advice.code is GainFact.GYRO_CUTOFF_LOW
        assert advice.figures["changes"] == (("IMU_GYRO_CUTOFF", 15.0, 30.0),)
        assert advice.figures["noise"] == approx(4e-4)
        assert advice.figures["new_phase_lag"] < 0.6 * advice.figures["phase_lag"]
        assert "IMU_GYRO_CUTOFF at 15 Hz costs" in advice.sentence
        assert advice.remedy.startswith("Fly the lower gains first:")
        assert "Then set the old gains with IMU_GYRO_CUTOFF 30," in advice.remedy
