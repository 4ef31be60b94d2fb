"""What a log shows of the hardware, a fact for each part: judged where an autopilot's own documentation has a limit."""

from mavdem.assessment.evidence import Evidence
from mavdem.assessment.hardware.calibration import calibration_fact
from mavdem.assessment.hardware.compasses import field_fact
from mavdem.assessment.hardware.controllers import controllers_fact
from mavdem.assessment.hardware.processor import processor_fact
from mavdem.assessment.hardware.receivers import receiver_fact
from mavdem.assessment.hardware.recording import recording_fact
from mavdem.assessment.hardware.temperatures import temperatures_fact
from mavdem.facts import NamedFacts
from mavdem.facts.hardware import HardwarePart

__all__ = ["hardware_facts"]


def hardware_facts(evidence: Evidence, lights: NamedFacts) -> NamedFacts:
    """Returns a fact about each part of the hardware that the log shows, by the name of the part.

    A fact whose level is unknown is not judged: no documentation has a limit for it.

    Args:
        evidence: signals, events and measurements of the vehicle.
        lights: the lights, of which the one on power is that part's fact.
    """
    facts = {
        HardwarePart.POWER: lights["power"],
        HardwarePart.CONTROLLERS: controllers_fact(evidence),
        HardwarePart.RECEIVERS: receiver_fact(evidence),
        HardwarePart.COMPASSES: field_fact(evidence),
        HardwarePart.PROCESSOR: processor_fact(evidence),
        HardwarePart.RECORDING: recording_fact(evidence),
        HardwarePart.TEMPERATURES: temperatures_fact(evidence),
        HardwarePart.CALIBRATION: calibration_fact(evidence.signals.telemetry),
    }
    return {str(part): fact for part, fact in facts.items() if fact is not None}
