"""A plot of a figure: lines over an axis, or dots. `draw` also returns notes for below the picture."""

import math

from . import bars
from .gnuplot import Picture, quoted
from .markup import number, short
from .notes import failed_notes, source_notes
from .style import BAD, PALETTE

LINES = {"ours": "solid", "limit": "(6,4)", "peer": "(2,3)", "paper": "solid"}
# a disc, a ring, a square, a diamond
MARKS = {"ours": "7 ps 0.8", "limit": "6 ps 0.8", "peer": "5 ps 0.8", "paper": "13 ps 1.4"}
MARGIN = 0.05  # share of the axis that stays free on both sides of the values


def draw(plot, name):
    """Returns (an svg element whose ids begin with `name`, [notes])."""
    picture, notes = bars.picture(plot) if plot.get("bars") else Curves(plot).picture()
    return picture.svg(name), notes


def statistic_of(plot):
    return plot.get("statistic", "mean_ms")


def colours(series):
    """The colour of each series. Series whose names agree after the first comma have one colour ("IoTCloud, 100/s" and
    "librabbitmq, 100/s" are a pair), so that the line's style shows the system and its colour the load."""
    keys = [each["name"].partition(", ")[2] or each["name"] for each in series]
    order = list(dict.fromkeys(keys))
    return [PALETTE[order.index(key) % len(PALETTE)][0] for key in keys]


class Axis:
    """Maps values to places on an axis. Values that are texts stand side by side in their order."""

    def __init__(self, values, log, from_zero=False):
        self.names = None
        if any(isinstance(value, str) for value in values):
            self.names = list(dict.fromkeys(map(str, values)))
        self.values = [] if self.names else [value for value in values if value > 0 or not log]
        self.log = log and bool(self.values)
        self.from_zero = from_zero

    def shows(self, value):
        return not self.log or value > 0

    def at(self, value):
        return self.names.index(str(value)) if self.names else value

    def settings(self, axis):
        if self.names:
            names = ", ".join(f"{quoted(name)} {index}" for index, name in enumerate(self.names))
            return [f"{axis}tics ({names})", f"{axis}range [-0.5:{len(self.names) - 0.5}]"]
        if not self.values:
            return [f"{axis}range [0:1]"]
        low, high = min(self.values), max(self.values)
        if not self.log:
            margin = (high - low) * MARGIN or abs(high) * MARGIN or 1.0
            return [f"{axis}range [{0 if self.from_zero and low >= 0 else low - margin}:{high + margin}]"]
        low, high = math.log10(low), math.log10(high)
        margin = max((high - low) * MARGIN, MARGIN)
        low, high = low - margin, high + margin
        ticks = ", ".join(f"{quoted(short(value))} {value}" for value in decades(low, high))
        return [f"logscale {axis}", f"{axis}range [{10**low}:{10**high}]", f"{axis}tics ({ticks})"]


def decades(low, high):
    """The values at which a logarithmic axis from 10^low to 10^high has labels; a few of them."""
    steps = (1,) if high - low > 3 else (1, 3) if high - low > 1.6 else (1, 2, 5)
    values = [step * 10.0**decade for decade in range(math.floor(low), math.ceil(high) + 1) for step in steps]
    inside = [value for value in values if low <= math.log10(value) <= high]
    return inside if len(inside) > 1 else [10**low, 10**high]


class Curves:
    def __init__(self, plot):
        self.plot, self.statistic = plot, statistic_of(plot)
        self.notes = failed_notes(plot) + source_notes(plot)
        every = [point for series in plot["series"] for point in series["points"]]
        self.x = Axis([point["x"] for point in every if "x" in point], plot.get("x_log", False))
        self.y = Axis([point[self.statistic] for point in every if self._has(point)], plot.get("y_log", False), from_zero=True)
        self.drawn = Picture(plot["title"], 320 + 20 * len(plot["series"]))

    def _has(self, point):
        value = point.get(self.statistic)
        return "x" in point and value is not None and math.isfinite(value)

    def picture(self):
        self.drawn.set("grid", f"xlabel {quoted(self._label('x'))} offset 0,0.8",
                       f"ylabel {quoted(self._label('y', self.plot.get('y') or self.statistic.removesuffix('_ms')))}",
                       *self.x.settings("x"), *self.y.settings("y"))
        for series, colour in zip(self.plot["series"], colours(self.plot["series"])):
            self._series(series, series.get("kind") if series.get("kind") in LINES else "ours", colour)
        return self.drawn, self.notes

    def _label(self, axis, name=None):
        name, unit = name or self.plot.get(axis, ""), self.plot.get(f"{axis}_unit")
        return name + (f" ({unit})" if unit else "") + (", log" if getattr(self, axis).log else "")

    def _series(self, series, kind, colour):
        rows, missing = [], 0
        for point in series["points"]:
            if "failed" in point:
                self._failed(series, point)
            elif not self._has(point):
                missing += 1
            elif not (self.x.shows(point["x"]) and self.y.shows(point[self.statistic])):
                self.notes.append(f"{series['name']}, at {point['x']}: {number(point[self.statistic])} has no place on a "
                                  "logarithmic axis")
            else:
                rows.append((self.x.at(point["x"]), point[self.statistic], point))
        if missing:
            self.notes.append(f"{series['name']}: {missing} of {len(series['points'])} points have no {self.statistic}")
        title = f'lc rgb "{colour}" title {quoted(series["name"])}'
        if not rows:
            self.drawn.curve(f"NaN with linespoints dt {LINES[kind]} lw 2 pt {MARKS[kind]} {title}")
            return
        rows.sort(key=lambda row: row[0])
        if self.plot.get("style") == "dots":
            self.drawn.curve(f"{self.drawn.block([row[:2] for row in rows])} with points pt 7 ps 0.25 {title}")
            return
        block = self.drawn.block([(*row[:2], self.drawn.said(self._said(series, row[2]))) for row in rows])
        line = "points" if kind == "paper" or self.x.names else f"linespoints dt {LINES[kind]} lw 2 pi -1"
        self.drawn.curve(f"{block} using 1:2 with {line} pt {MARKS[kind]} {title}")
        self.drawn.curve(f'{block} using 1:2:3 with labels hypertext point pt {MARKS[kind]} lc rgb "{colour}" notitle')

    def _said(self, series, point):
        unit = self.plot.get("y_unit", "")
        said = f"{series['name']}, at {point['x']}: {number(point[self.statistic])} {unit}".rstrip()
        return said + (f" ({point['source']})" if point.get("source") else "")

    def _failed(self, series, point):
        if "x" in point and self.x.shows(point["x"]):
            said = self.drawn.said(f"{series['name']}, at {point['x']}: FAILED: {point['failed']}")
            self.drawn.set(f'label "{said}" at first {self.x.at(point["x"])}, graph 0.97 hypertext '
                           f'point pt 2 ps 1.2 lw 2 lc rgb "{BAD[0]}"')
