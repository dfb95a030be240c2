"""The report: one page and its plots, drawn from the JSON files of build/bench. `page.write(folder)` writes them again."""

from .page import write  # noqa: F401
