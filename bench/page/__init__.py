"""The report: one page and its pictures, drawn from the JSON files of build/bench. `page.write(folder)` writes them again,
`page.write_pictures(folder)` the pictures alone."""

from .page import name_of, put, write, write_pictures  # noqa: F401
