"""The record of what can be trusted in one boot: every sensor checked against another one."""

from dataclasses import dataclass

from mavdem.dataset.signals import Signals
from mavdem.dataset.vehicle_cache import cached_per_vehicle
from mavdem.witnesses.accelerometer import AccelerometerWitness, accelerometer_witness
from mavdem.witnesses.flight_verdict import FlightVerdict, flight_verdict
from mavdem.witnesses.height import HeightWitnesses, height_witnesses
from mavdem.witnesses.position import fix_share
from mavdem.witnesses.rotation import RotationWitness, rotation_witness


@dataclass(frozen=True, eq=False)
class SensorTrust:
    """Which sensors of one boot can be trusted; a question that the log cannot answer is None."""

    boot: int
    """Number of the boot."""
    height: HeightWitnesses
    """Barometer and estimated climb, and when they contradict each other."""
    accelerometer: AccelerometerWitness | None
    """Gravity at rest, and peaks."""
    rotation: RotationWitness | None
    """Whether roll and pitch answer their setpoints, and whether gyro and attitude agree."""
    verdict: FlightVerdict
    """Whether the vehicle flew."""
    fix_share: float | None
    """Share of the time under power with a position fix of GPS; None if no receiver was recorded."""

    @property
    def is_barometer_usable(self) -> bool | None:
        """Whether the barometer measures the height; None without one."""
        if self.height.barometer_noise is None:
            return None
        return self.height.barometer is not None

    @property
    def is_climb_estimate_sound(self) -> bool | None:
        """Whether the estimated climb never contradicts the barometer for long; None if one of them is not known."""
        if self.height.barometer_climb is None or self.height.estimated_climb is None:
            return None
        return not self.height.contradictions

    @property
    def is_accelerometer_sound(self) -> bool | None:
        """Whether the accelerometer measures gravity at rest; None if the vehicle never rested."""
        return None if self.accelerometer is None else self.accelerometer.is_sound

    @property
    def has_position_fix(self) -> bool | None:
        """Whether GPS had a fix at any time under power; None if no receiver was recorded."""
        return None if self.fix_share is None else self.fix_share > 0

    @property
    def attitude_answers(self) -> bool | None:
        """Whether roll and pitch follow their setpoints; None if the setpoints ask for too little to tell."""
        return None if self.rotation is None else self.rotation.answers

    @property
    def gyro_agrees(self) -> bool | None:
        """Whether gyro and attitude agree; None where the vehicle hardly turned."""
        return None if self.rotation is None else self.rotation.gyro_agrees

    @property
    def flew(self) -> bool | None:
        """Whether the vehicle flew; None if the witnesses do not decide it."""
        return self.verdict.has_flown


@cached_per_vehicle()
def sensor_trust(signals: Signals, boot: int) -> SensorTrust:
    """Checks the sensors of a boot against each other.

    Args:
        signals: signals of the vehicle.
        boot: number of the boot.
    """
    return SensorTrust(
        boot=boot,
        height=height_witnesses(signals, boot),
        accelerometer=accelerometer_witness(signals, boot),
        rotation=rotation_witness(signals, boot),
        verdict=flight_verdict(signals, boot),
        fix_share=fix_share(signals, boot),
    )
