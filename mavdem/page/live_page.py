"""The page of a live flight: how well it was predicted, what happened when, and the model at its end."""

from __future__ import annotations

from collections.abc import Mapping

from mavdem.evaluate.live_history import LiveHistory
from mavdem.live import SessionStatus
from mavdem.page.document import Chapter, render_page
from mavdem.report.live import event_blocks, live_report


def live_page(link: str, axis: str, history: LiveHistory, status: SessionStatus, account: Mapping[str, float]) -> str:
    """The HTML of a live flight over a ``link``; ``account`` are its seconds by the keys of ``ACCOUNT``."""
    return render_page(
        f"Flight over {link}",
        f"What {axis} did, learned and predicted while it flew.",
        live_report(history, status, account, axis),
        [Chapter("What happened", event_blocks(history))],
    )
