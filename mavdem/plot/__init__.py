"""Pictures of learnt models: each function draws one as a ``matplotlib.figure.Figure``, without ``pyplot``.

``learned.plot`` has them as methods. Their colours are those of ``mavdem.report.palette``, angles are in degrees, and
nothing is drawn behind them, so that a page of either theme can hold them.
"""

from mavdem.plot.complex_plane import poles
from mavdem.plot.forecasts import forecast
from mavdem.plot.iterations import learning
from mavdem.plot.motor_balance import motors
from mavdem.plot.one_step_errors import residuals
from mavdem.plot.plots import Plots
from mavdem.plot.responses import bode, step
from mavdem.plot.torque import disturbance

__all__ = ["Plots", "bode", "disturbance", "forecast", "learning", "motors", "poles", "residuals", "step"]
