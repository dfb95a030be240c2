"""Figure 12: the TurtleBot's loop with the real processes, and where its time goes; the same on Apache Storm; and with a worker
that is placed on busy cores."""

from .figure import FIGURE  # noqa: F401
from .on_storm import FIGURE as ON_STORM  # noqa: F401
from .placed import FIGURE as PLACED  # noqa: F401
