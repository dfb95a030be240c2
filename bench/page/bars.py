"""Where a time goes: for each statistic a bar of the parts one after the other, and a bar of each thing beside."""

from .axes import Axis
from .markup import element, escape, number
from .notes import failed_notes, source_notes
from .style import PALETTE
from .svg import WIDTH, legend, picture, text

LEFT, RIGHT, TOP, BAR, ROW = 16, 70, 44, 18, 44
NAMES = {"slowest_ms": "mean of the slowest hundredth"}
TOO_FAR = 2.5  # times the longest other bar: the paper's is cut off and its length said


def draw(plot):
    """(an svg element, [notes]). Each series has one point; those of the kind `part` make one bar together."""
    notes = failed_notes(plot) + source_notes(plot)
    parts = [series for series in plot["series"] if series["kind"] == "part"]
    others = [series for series in plot["series"] if series["kind"] != "part"]
    rows = []  # (title, kind, [(colour, name, value)])
    for statistic in plot["bars"]:
        named = NAMES.get(statistic, statistic.removesuffix("_ms"))
        pieces = [(index % len(PALETTE), part["name"], value(part, statistic)) for index, part in enumerate(parts)]
        if any(piece[2] is not None for piece in pieces):
            rows.append((f"{named}: its parts", "part", [piece for piece in pieces if piece[2] is not None]))
        for series in others:
            if value(series, statistic) is not None:
                rows.append((f"{named}, {series['name']}", series["kind"], [(7, series["name"], value(series, statistic))]))
    for series in others:  # the paper may say a mean only
        if all(value(series, statistic) is None for statistic in plot["bars"]) and value(series, "mean_ms") is not None:
            rows.append((f"mean, {series['name']}", series["kind"], [(7, series["name"], value(series, "mean_ms"))]))
    lengths = {row: sum(piece[2] for piece in pieces) for row, (_, _, pieces) in enumerate(rows)}
    near = [lengths[row] for row, (_, kind, _) in enumerate(rows) if kind != "paper"] or list(lengths.values()) or [1.0]
    longest = max(near)
    bottom = TOP + ROW * len(rows)
    axis = Axis([0, *(length for length in lengths.values() if length <= TOO_FAR * longest)], LEFT, WIDTH - RIGHT,
                from_zero=True)
    drawn = [grid(axis, bottom, plot.get("y_unit", "ms"))]
    for row, (title, kind, pieces) in enumerate(rows):
        drawn.append(bar(axis, TOP + ROW * row, title, kind, pieces, plot.get("y_unit", "ms")))
    samples = [(part["name"], element("rect", class_=f"f{index % len(PALETTE)}", x=8, y=-8, width=14, height=14))
               for index, part in enumerate(parts)]
    below, height = legend(samples, bottom + 52)
    return picture(plot["title"], drawn + [below], height), notes


def value(series, statistic):
    point = series["points"][0] if series["points"] else {}
    return None if "failed" in point else point.get(statistic)


def grid(axis, bottom, unit):
    lines = [element("line", class_="grid", x1=f"{pixel:.1f}", x2=f"{pixel:.1f}", y1=TOP - 6, y2=bottom)
             + text(pixel, bottom + 16, name, "middle") for pixel, name in axis.ticks()]
    return "".join(lines) + text(WIDTH - RIGHT + 16, bottom + 16, unit)


def bar(axis, y, title, kind, pieces, unit):
    parts = [text(LEFT, y + 8, title)]
    at, total = 0.0, sum(piece[2] for piece in pieces)
    end = min(axis.at(total), WIDTH - RIGHT)
    for colour, name, length in pieces:
        begin, stop = axis.at(at), min(axis.at(at + length), WIDTH - RIGHT)
        said = element("title", escape(f"{name}: {number(length)} {unit}"))
        parts.append(element("rect", said, class_=f"mark f{colour}" if kind in ("part", "ours") else f"mark s{colour} hollow",
                             x=f"{begin:.1f}", y=y + 13, width=f"{max(stop - begin, 0.5):.1f}", height=BAR))
        at += length
    arrow = " \u2192" if axis.at(total) > WIDTH - RIGHT else ""
    return "".join(parts) + text(end + 6, y + 13 + BAR - 4, f"{number(total)}{arrow}")
