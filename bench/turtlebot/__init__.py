"""Figure 12: the TurtleBot's loop with the real processes, and where its time goes; and the same on Apache Storm."""

from .figure import FIGURE  # noqa: F401
from .on_storm import FIGURE as ON_STORM  # noqa: F401
