"""Tuning: gains to set of the axes of a flight, and what to do with them."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

from mavdem.assessment.assess import Assessment
from mavdem.assessment.evidence import Evidence
from mavdem.assessment.judgement import Judgement
from mavdem.assessment.lights.tracking import tracking_of
from mavdem.containers import group_by
from mavdem.errors import NotLearnable
from mavdem.facts import Fact
from mavdem.facts.assessment import NextStep
from mavdem.facts.loops import Loops
from mavdem.facts.margins import TrackingLight
from mavdem.immutable import freeze
from mavdem.ingest.telemetry import Parameters
from mavdem.loops.advice import Advice, advise
from mavdem.loops.axis_loops import MARGIN_TARGETS, Loop, margin_rating

AdviceByAxis = dict[str, Advice | Fact]
"""The advice by axis, or why there is none."""


class Tuning(NamedTuple):
    """Gains to set."""

    axes: AdviceByAxis
    advice: Sequence[Advice]  # of those whose loops are known, one at least
    parameters: Parameters  # to set, by the autopilot's name, where they change
    notch: Fact | None  # the filter to set, or why there is none; None where it was not asked for
    # of the flight; its next step is to load the gains, unless something else is bad
    judgement: Judgement

    @property
    def refusal(self) -> Fact | None:
        """Why no gains are advised; None where some are."""
        return None if any(each.gains for each in self.advice) else self.advice[0].sentence


def tuned(
    assessment: Assessment,
    evidence: Evidence,
    axes: Sequence[str],
    margins: str = "default",
    *,
    is_written: bool,
    more: bool = False,
    filters: bool = False,
) -> Tuning:
    """Returns gains of these ``axes`` of an assessed vehicle, with the ``margins`` of that name in ``MARGIN_TARGETS``.

    ``more``: also of loops that have enough margin; ``filters``: with a notch filter; ``is_written``: whether a file
    will have them. Raises NotLearnable: the loops of no axis are known; what is bad of the vehicle it says first.
    """
    judgement = assessment.judgement
    headline = judgement.headline
    grounds = evidence.grounds
    motors = judgement.lights["motors"]
    if not grounds and motors.is_bad:
        grounds = (motors,)
    first = [headline] if headline.is_bad and not grounds else []
    if evidence.lowered:
        grounds = (*grounds, evidence.lowered)
    notch = assessment.noise.notch if filters and not grounds else None
    settings = dict(notch.figures.get("settings", ())) if notch else {}
    measured = {margin.axis: margin.facts[0] for margin in evidence.margins if margin.injected}
    tracking = tracking_of(evidence)
    by_axis = AdviceByAxis()
    advised = list[Advice]()
    refused = dict[str, Fact]()
    for axis in axes:
        loop = evidence.loops[axis]
        if isinstance(loop, Fact) and axis in measured:
            loop = Fact(Loops.NO_LOOP, reasons=(measured[axis], loop))
        if isinstance(loop, Loop):
            # What a flight injects is no answer of the controller.
            doubts = (*grounds, measured[axis]) if axis in measured else grounds
            followed = tracking[axis]
            # No loop with enough margin overshoots.
            if (
                followed.code is TrackingLight.OVERSHOOTS_SETPOINT
                and not margin_rating(loop, MARGIN_TARGETS[margins]).is_bad
            ):
                doubts = (*doubts, followed)
            advice = advise(loop, margins, doubts, more=more)
            if settings and not advice.refusals:
                advice = advise(loop.with_parameters(settings), margins, more=more)
            by_axis[axis] = advice
            advised.append(advice)
        elif first or grounds or len(axes) > 1:
            by_axis[axis] = refused[axis] = Fact(Loops.NO_LOOP, reasons=grounds or (loop,))
        else:
            raise NotLearnable(loop)
    if not advised:
        alike = group_by(refused, refused.__getitem__)
        reasons = [fact.but(names=names) for fact, names in alike.items()]
        first += reasons if len(alike) > 1 else alike
        raise NotLearnable(Loops.NO_LOOP, reasons=first)
    gains = {
        name: value
        for each in advised
        if each.gains  # a notch costs phase, which is not known to be there otherwise
        for name, value in {**each.parameters, **settings}.items()
    }
    if gains and (not headline.is_bad or headline == judgement.lights["margins"]):
        following = Fact(NextStep.LOAD_GAINS, headline.level, is_written=is_written)
        judgement = replace(judgement, next_step=following)
    return freeze(Tuning(by_axis, advised, gains, notch, judgement))
