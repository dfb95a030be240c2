"""A plot of a figure as SVG: lines over an axis, or dots. `draw` also tells what the picture alone does not say."""

import math

from . import bars
from .axes import Axis
from .markup import element, escape, number
from .notes import failed_notes, source_notes
from .style import PALETTE
from .svg import WIDTH, legend, picture, text

LEFT, RIGHT, TOP, HEIGHT = 62, 14, 40, 260  # of the area with the curves
KINDS = ("ours", "limit", "peer", "paper")


def draw(plot):
    """(an svg element, [notes])"""
    return bars.draw(plot) if plot.get("bars") else Curves(plot).draw()


def statistic_of(plot):
    return plot.get("statistic", "mean_ms")


def colours(series):
    """Which colour each has: what comes after the first comma of the names decides ("IoTCloud, 100/s" and "librabbitmq,
    100/s" are a pair), so that the line's style tells who and the colour at what."""
    keys = [each["name"].partition(", ")[2] or each["name"] for each in series]
    order = list(dict.fromkeys(keys))
    return [order.index(key) % len(PALETTE) for key in keys]


class Curves:
    def __init__(self, plot):
        self.plot, self.statistic = plot, statistic_of(plot)
        self.notes = failed_notes(plot) + source_notes(plot)
        self.dots = plot.get("style") == "dots"
        every = [point for series in plot["series"] for point in series["points"]]
        xs = [point["x"] for point in every if "x" in point]
        ys = [point[self.statistic] for point in every if self._has(point)]
        self.x = Axis(xs, LEFT, WIDTH - RIGHT, plot.get("x_log", False))
        self.y = Axis(ys, TOP + HEIGHT, TOP, plot.get("y_log", False), from_zero=True)

    def _has(self, point):
        value = point.get(self.statistic)
        return "x" in point and value is not None and math.isfinite(value)

    def draw(self):
        parts = [self._grid()]
        entries = []
        for series, colour in zip(self.plot["series"], colours(self.plot["series"])):
            kind = series.get("kind") if series.get("kind") in KINDS else "ours"
            parts.append(self._series(series, kind, colour))
            entries.append((series["name"], self._sample(kind, colour)))
        below, height = legend(entries, TOP + HEIGHT + 58)
        return picture(self.plot["title"], parts + [below], height), self.notes

    def _grid(self):
        bottom = TOP + HEIGHT
        parts = [element("line", class_="axis", x1=LEFT, x2=WIDTH - RIGHT, y1=bottom, y2=bottom)]
        for pixel, name in self.x.ticks():
            parts += [element("line", class_="grid", x1=f"{pixel:.1f}", x2=f"{pixel:.1f}", y1=TOP, y2=bottom),
                      text(pixel, bottom + 18, name, anchor="middle")]
        for pixel, name in self.y.ticks():
            parts += [element("line", class_="grid", x1=LEFT, x2=WIDTH - RIGHT, y1=f"{pixel:.1f}", y2=f"{pixel:.1f}"),
                      text(LEFT - 6, pixel + 4, name, anchor="end")]
        named = self.plot.get("y") or self.statistic.removesuffix("_ms")
        parts += [text((LEFT + WIDTH - RIGHT) / 2, bottom + 38, self._label("x"), anchor="middle"),
                  element("text", escape(self._label("y", named)), transform=f"translate(15,{TOP + HEIGHT / 2}) rotate(-90)",
                          text_anchor="middle")]
        return "".join(parts)

    def _label(self, axis, name=None):
        name, unit = name or self.plot.get(axis, ""), self.plot.get(f"{axis}_unit")
        return name + (f" ({unit})" if unit else "") + (", log" if getattr(self, axis).log else "")

    def _series(self, series, kind, colour):
        drawn, marks, missing = [], [], 0
        for point in series["points"]:
            if "failed" in point:
                marks.append(self._failed(series, point))
            elif not self._has(point):
                missing += 1
            elif not (self.x.shows(point["x"]) and self.y.shows(point[self.statistic])):
                self.notes.append(f"{series['name']}, at {point['x']}: {number(point[self.statistic])} has no place on a "
                                  "logarithmic axis")
            else:
                drawn.append((self.x.at(point["x"]), self.y.at(point[self.statistic]), point))
        if missing:
            self.notes.append(f"{series['name']}: {missing} of {len(series['points'])} points have no {self.statistic}")
        if self.dots:
            path = "".join(f"M{x:.1f} {y:.1f}h0" for x, y, _ in drawn)
            return element("path", class_=f"s{colour}", d=path, stroke_width=3, stroke_linecap="round", fill="none")
        line = ""
        if kind != "paper" and len(drawn) > 1 and not self.x.names:
            places = " ".join(f"{x:.1f},{y:.1f}" for x, y, _ in sorted(drawn, key=lambda place: place[0]))
            line = element("polyline", class_=f"line {kind} s{colour}", points=places)
        return line + "".join(self._mark(kind, colour, x, y, self._said(series, point)) for x, y, point in drawn) + "".join(
            marks)

    def _said(self, series, point):
        unit = self.plot.get("y_unit", "")
        said = f"{series['name']}, at {point['x']}: {number(point[self.statistic])} {unit}".rstrip()
        return said + (f" ({point['source']})" if point.get("source") else "")

    def _failed(self, series, point):
        if "x" not in point or not self.x.shows(point["x"]):
            return ""
        x, y = self.x.at(point["x"]), TOP + 8
        cross = f"M{x - 6:.1f} {y - 6}l12 12m0 -12l-12 12"
        title = element("title", escape(f"{series['name']}, at {point['x']}: FAILED: {point['failed']}"))
        return element("g", title + element("path", class_="bad", d=cross))

    @staticmethod
    def _mark(kind, colour, x, y, said):
        place, title = {"class_": f"mark s{colour} f{colour}"}, element("title", escape(said)) if said else ""
        if kind == "paper":
            return element("path", title, **place, d=f"M{x:.1f} {y - 7:.1f}l7 7l-7 7l-7 -7z")
        if kind == "peer":
            return element("rect", title, **place, x=f"{x - 4:.1f}", y=f"{y - 4:.1f}", width=8, height=8)
        if kind == "limit":
            place["class_"] = f"mark s{colour} hollow"
        return element("circle", title, **place, cx=f"{x:.1f}", cy=f"{y:.1f}", r=4)

    def _sample(self, kind, colour):
        """What stands for a series in the legend, at 0, 0."""
        mark = self._mark(kind, colour, 15, 0, "")
        line = element("line", class_=f"line {kind} s{colour}", x1=0, x2=30, y1=0, y2=0)
        return mark if kind == "paper" or self.dots else line + mark
