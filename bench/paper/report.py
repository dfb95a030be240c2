"""`./dev bench paper`: the measurements of the paper's section 5, one JSON file for each figure."""

import datetime
import json
import os
import sys
import time
from pathlib import Path

import page
import storm_report
import storm_soak
import turtlebot
import versions
from brokers_report import Report
from figures import ProgramFailed, command_line, commit, machine
from paper import drivers, sizes
from paper.points import Progress
from paper.systems import KINDS, StartError, Unavailable

# The figures in the order in which they run. Each has: `name`, `title`, `broker` (one of KINDS, or None), `servers`
# (whose versions versions.py finds for the file), `seconds(given)` (about how long it takes) and
# `take(given, report, progress)`, which adds to the report's results and returns the plots. `given` has `scale`
# ("quick", "usual", "full"), `build` and `out` (the folder of the figures' files). take() raises ProgramFailed or
# StartError when nothing can be measured. A point that cannot be measured becomes {"x": .., "failed": why}, and
# report.fail() is told why. One with `alone` is taken only when it is named.
FIGURES = [
    *sizes.FIGURES,
    *drivers.FIGURES,
    turtlebot.FIGURE,
    storm_report.FIGURE,
    storm_soak.SOAK,
    turtlebot.ON_STORM,
    turtlebot.PLACED,
]


def chosen(given):
    """The figures that the command line asks for."""
    return [figure for figure in FIGURES
            if (figure.name in given.figure if given.figure else not getattr(figure, "alone", False))
            and (not given.broker or figure.broker is None or figure.broker in given.broker)]


def file_of(folder, figure):
    return folder / (f"figure-{figure.name}.json" if figure.name[0].isdigit() else f"{figure.name}.json")


def write(given, figure, facts, report, plots):
    """Writes the figure's file by way of a rename, so that a reader never sees a part of it."""
    facts = {**facts, "load_average_after": os.getloadavg()[0]}
    content = {"figure": figure.name, "title": figure.title, "machine": facts, "commit": commit(Path(__file__).parent),
               "command": command_line(sys.argv[1:]),
               "taken": datetime.datetime.now(datetime.timezone.utc).isoformat(timespec="seconds"),
               "quick": given.scale == "quick", "scale": given.scale,
               "versions": versions.asked(given.build, *figure.servers), **report.written(), "plots": plots}
    file = file_of(given.out, figure)
    part = file.with_suffix(".part")
    part.write_text(json.dumps(content, indent=1) + "\n")
    part.replace(file)
    return file


def take(given, figure, whole, progress):
    """Measures one figure. Its results are also added to `whole`."""
    print(f"\nfigure {figure.name}: {figure.title}", flush=True)
    facts, report, plots = machine(), Report(), []
    report.print_head()
    began = time.monotonic()
    try:
        plots = figure.take(given, report, progress)
    except (ProgramFailed, StartError, Unavailable) as failure:
        report.fail(f"figure {figure.name}: GIVEN UP: {failure}")
    whole.results += report.results
    whole.reasons += report.reasons
    file = write(given, figure, facts, report, plots)
    page.write(given.out.parent)
    progress.figure_done(figure.seconds(given))
    print(f"figure {figure.name}: {time.monotonic() - began:.0f} s, {file}", flush=True)


def run_paper(given):
    given.scale = "quick" if given.quick else "full" if given.full else "usual"
    given.out.mkdir(parents=True, exist_ok=True)
    figures, whole = chosen(given), Report()
    if not figures:
        raise ProgramFailed("there is no such figure; there are: "
                            + ", ".join(f"{figure.name} ({figure.broker or 'no broker'})" for figure in FIGURES))
    progress = Progress(sum(figure.seconds(given) for figure in figures))
    print(f"{len(figures)} figures, about {max(1, progress.all_s / 60):.0f} minutes", flush=True)
    for figure in figures:
        take(given, figure, whole, progress)
    return whole, whole.verdict() + ("\n  FAILED, see above" if whole.failed else "")


def add_options(command, root):
    scale = command.add_mutually_exclusive_group()
    scale.add_argument("--quick", action="store_true", help="few points, one round: about five minutes, and Storm's seven")
    scale.add_argument("--full", action="store_true", help="all points, five rounds: some five hours")
    names = [figure.name for figure in FIGURES]
    command.add_argument("--figure", action="append", choices=names, help="this one; may be given several times")
    command.add_argument("--broker", action="append", choices=list(KINDS), help="its figures; may be given several times")
    command.add_argument("--points", metavar="REGEX", help="those in whose name this is found, as in '60 KB, 4 x 100/s'; "
                         "the figure's file has no others then")
    command.add_argument("--rounds", type=int, help="default: 3 (figures 10 and 11: 2), with --quick 1, with --full 5")
    command.add_argument("--out", type=Path, default=root / "build/bench/paper", help="where the figures' files go")
