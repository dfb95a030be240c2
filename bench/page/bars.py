"""A picture of where a time goes: for each statistic a bar made of the parts, and a bar for each thing that it is
compared with."""

from .gnuplot import Picture, quoted
from .markup import number
from .notes import failed_notes, source_notes
from .style import PALETTE

ROW, BAR = 44, 0.36  # pixels of a row, and the share of it that the bar takes
NAMES = {"slowest_ms": "mean of the slowest hundredth"}
# a bar of the paper that is so many times longer than the longest other bar is cut off; a text says its length
TOO_FAR = 2.5
BESIDE = PALETTE[7]


def picture(plot):
    """Returns (a Picture, [notes]). Each series of `plot` has one point; the series of the kind `part` make one bar
    together."""
    bars = rows(plot)
    lengths = [sum(piece[2] for piece in pieces) for _, _, pieces in bars]
    near = [length for length, (_, kind, _) in zip(lengths, bars) if kind != "paper"] or lengths or [1.0]
    longest = max([length for length in lengths if length <= TOO_FAR * max(near)] or near)
    end = (longest or 1.0) * 1.15  # leaves room for the number behind the bar
    unit = plot.get("y_unit", "ms")
    drawn = Picture(plot["title"], 100 + ROW * len(bars) + 10 * len(plot["series"]))
    drawn.set("grid xtics", "border 0", "tics scale 0", "format y ''", f"xrange [0:{end}]",
              f"yrange [{max(len(bars), 1)}:0]", f"xlabel {quoted(unit)} offset 0,0.8")
    in_legend = set()
    for index, (title, kind, pieces) in enumerate(bars):
        at, total = 0.0, lengths[index]
        drawn.set(f"label {quoted(title)} at 0,{index + 0.25}")
        for colour, name, length in pieces:
            stop = min(at + length, end)
            block = drawn.block([(at, index + 0.66, at, stop, index + 0.66 - BAR / 2, index + 0.66 + BAR / 2)])
            legend = f"title {quoted(name)}" if kind == "part" and name not in in_legend else "notitle"
            in_legend |= {name} if kind == "part" else set()
            filled = "solid noborder" if kind in ("part", "ours") else "empty"
            drawn.curve(f'{block} using 1:2:3:4:5:6 with boxxyerror fs {filled} lc rgb "{colour}" {legend}',
                        f"{name}: {number(length)} {unit}")
            at += length
        arrow = " \u2192" if total > end else ""
        drawn.set(f"label {quoted(number(total) + arrow)} at {min(total, end)},{index + 0.66} "
                  f"{'right offset -1,0' if arrow else 'left offset 0.6,0'} front")
    return drawn, failed_notes(plot) + source_notes(plot)


def rows(plot):
    """The bars from top to bottom: [(title, kind, [(colour, name, value)])]."""
    parts = [series for series in plot["series"] if series["kind"] == "part"]
    others = [series for series in plot["series"] if series["kind"] != "part"]
    found = []
    for statistic in plot["bars"]:
        named = NAMES.get(statistic, statistic.removesuffix("_ms"))
        pieces = [(PALETTE[index % len(PALETTE)][0], part["name"], value(part, statistic)) for index, part in enumerate(parts)]
        if any(piece[2] is not None for piece in pieces):
            found.append((f"{named}: its parts", "part", [piece for piece in pieces if piece[2] is not None]))
        found += [(f"{named}, {series['name']}", series["kind"], [(BESIDE[0], series["name"], value(series, statistic))])
                  for series in others if value(series, statistic) is not None]
    for series in others:  # of the paper there may be only a mean
        if all(value(series, statistic) is None for statistic in plot["bars"]) and value(series, "mean_ms") is not None:
            found.append((f"mean, {series['name']}", series["kind"], [(BESIDE[0], series["name"], value(series, "mean_ms"))]))
    return found


def value(series, statistic):
    point = series["points"][0] if series["points"] else {}
    return None if "failed" in point else point.get(statistic)
