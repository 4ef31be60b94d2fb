"""What a log shows of the hardware, a fact (a coded finding) for each device, judged by the autopilot's limits."""

from mavdem.assessment.evidence import Evidence
from mavdem.assessment.hardware.calibration import calibration_fact
from mavdem.assessment.hardware.compasses import field_fact
from mavdem.assessment.hardware.controllers import controllers_fact
from mavdem.assessment.hardware.processor import processor_fact
from mavdem.assessment.hardware.receivers import receiver_fact
from mavdem.assessment.hardware.recording import recording_fact
from mavdem.assessment.hardware.temperatures import temperatures_fact
from mavdem.assessment.lights.power import further_power_warnings
from mavdem.facts import NamedFacts
from mavdem.facts.hardware import HardwarePart

__all__ = ["hardware_facts"]


def hardware_facts(evidence: Evidence, lights: NamedFacts) -> NamedFacts:
    """Returns a fact about each device or other subject of the hardware that the log shows, by its name.

    A fact whose level is unknown is not judged: no documentation has a limit for it.

    Args:
        evidence: signals, events and measurements of the vehicle.
        lights: the facts of the status lights by name; the light of the power is the fact about the batteries.
    """
    facts = {
        HardwarePart.POWER: lights["power"],
        **further_power_warnings(evidence, lights["power"]),
        HardwarePart.CONTROLLERS: controllers_fact(evidence),
        HardwarePart.RECEIVERS: receiver_fact(evidence),
        HardwarePart.COMPASSES: field_fact(evidence),
        HardwarePart.PROCESSOR: processor_fact(evidence),
        HardwarePart.RECORDING: recording_fact(evidence),
        HardwarePart.TEMPERATURES: temperatures_fact(evidence),
        HardwarePart.CALIBRATION: calibration_fact(evidence.signals.telemetry),
    }
    return {str(subject): fact for subject, fact in facts.items() if fact is not None}
