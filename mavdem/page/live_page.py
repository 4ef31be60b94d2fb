"""The page of a live flight: how well it was predicted, what happened when, and the model at its end."""

from __future__ import annotations

from collections.abc import Mapping

from mavdem.dem import Learned
from mavdem.live import SessionStatus
from mavdem.live.history import LiveHistory
from mavdem.page.document import Chapter, render_page
from mavdem.page.learned_page import model_plans
from mavdem.page.pictures import PicturePlan, picture_chapter
from mavdem.report.live import event_blocks, live_report
from mavdem.report.screen import key_figures, screen


def live_page(
    link: str,
    axis: str,
    history: LiveHistory,
    status: SessionStatus,
    account: Mapping[str, float],
    learned: Learned | None,
) -> str:
    """The HTML of a live flight.

    Args:
        link: that it came over.
        axis: of the motion.
        history: what was collected in flight.
        status: at the end.
        account: seconds by the keys of ``ACCOUNT``.
        learned: the model at the end, if there is one.
    """

    def plans() -> list[PicturePlan]:
        from mavdem.plot.live_flight import live_flight

        caption = (
            "The predictions were made in flight, without the motors of the time ahead; band: 90 %. Below, the wind's "
            "torque as estimated in flight. What is shaded was learned from."
        )
        flown = PicturePlan("The flight", caption, lambda: live_flight(history, axis), large=True)
        return [flown, *([] if learned is None else model_plans(learned))]

    return render_page(
        f"Flight over {link}",
        f"What {axis} did, learned and predicted while it flew.",
        live_report(history, status, account, axis),
        [
            picture_chapter(plans),
            Chapter("What happened", event_blocks(history)),
            Chapter("The model at the end", [] if learned is None else screen(learned)),
        ],
        [] if learned is None else key_figures(learned),
    )
