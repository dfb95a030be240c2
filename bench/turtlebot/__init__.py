"""Figure 12: the TurtleBot's loop with the real processes, and where its time goes."""

from .figure import FIGURE  # noqa: F401
