"""What of a log is analysed on one axis, and how the steps of that work are shown."""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field

from mavdem.dem import Settings
from mavdem.experiments.held_out import Progress
from mavdem.experiments.window import Length
from mavdem.files import PathName

ShowStep = Callable[..., AbstractContextManager[Progress]]
"""Shows a step of the work, given its ``title`` and whether it is ``measured``.

It returns a context, which yields a function. A measured step calls that with the fraction of the work that is done.
"""


def show_nothing(title: str, measured: bool = True) -> AbstractContextManager[Progress]:
    """Shows no step of the work. It has the parameters of :data:`ShowStep`."""
    return nullcontext(lambda share: None)


@dataclass(frozen=True)
class Options:
    """What of a log is analysed, and how a model is learned."""

    inputs: str | None = None
    """Inputs of the model, as for :func:`mavdem.read_flight`."""
    settings: Settings = field(default_factory=Settings)
    """Settings of the fits."""
    start: float = 0.0
    """Time at the beginning of the settled flight that is left out, s."""
    train: Length | None = None
    """Length of the training data; None to train on all of the flight, and to test by cross-validation."""
    test: Length | None = None
    """Length of a test window; None for the default."""
    truth: PathName | None = None
    """Truth file of a simulated flight."""
    with_model: bool = True
    """Whether to learn the model. Without it only a model of the slow motion is learned, since its test decides whether
    there is one."""
    with_motors: bool = True
    """Whether to search the flight for weak motors and oscillations, and to align all its segments.

    Without it, and without a model, only that is computed which decides whether a model can be learned. Of hours of
    flight this takes a small part of the time.
    """
