"""Tables of results and of points."""

from .causes import inline
from .markup import element, escape, number
from .plots import statistic_of

STATISTICS = (("n", "n"), ("lost", "lost"), ("mean_ms", "mean"), ("p50_ms", "p50"), ("p99_ms", "p99"), ("max_ms", "max"),
              ("stddev_ms", "stddev"))
SHORT = 25  # rows; a longer table is folded


def table(heads, rows):
    """A table. `heads` are text, cells are markup; a cell may have its own <td>."""
    head = "".join(element("th", escape(each) or " ", scope="col") for each in heads)
    body = "".join("<tr>" + "".join(cell if cell.startswith("<td") else f"<td>{cell}</td>" for cell in row) + "</tr>"
                   for row in rows)
    return f'<div class="wide"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'


def folded(summary, content, is_open=False):
    return element("details", element("summary", escape(summary)) + content, open="open" if is_open else None)


def name_cell(text, **attributes):
    return element("td", escape(text), class_="name", **attributes)


def points(plot):
    """A table of all points of a plot with all their values."""
    drawn = statistic_of(plot)
    columns = STATISTICS if drawn in dict(STATISTICS) else (("n", "n"), (drawn, plot.get("y") or drawn))
    heads = ["series", plot.get("x") or "", *(title for _, title in columns), "source"]
    rows = []
    for series in plot["series"]:
        for point in series["points"]:
            cells = [name_cell(series["name"]), escape(number(point.get("x")))]
            if "failed" in point:
                cells.append(element("td", escape(f"FAILED: {point['failed']}"), class_="cause missed",
                                     colspan=len(columns) + 1))
            else:
                cells += [escape(number(point.get(key))) for key, _ in columns]
                cells.append(element("td", escape(point.get("source", "")) or " ", class_="cause" if point.get("source") else None))
            rows.append(cells)
    return folded(f"The points: {plot['title']} ({len(rows)}, in {plot.get('y_unit', 'ms')})", table(heads, rows))


def verdict(met):
    if met is None:
        return ""
    return '<span class="met">met</span>' if met else '<span class="missed">MISSED</span>'


def _figures(result):
    of_rounds = result.get("ratio_spread")
    ratio = number(result.get("ratio")) + (f" ({number(of_rounds[0])} to {number(of_rounds[1])})" if of_rounds else "")
    return [name_cell(result.get("name", "")), escape(number(result.get("value"))), escape(result.get("unit") or ""),
            escape(result.get("baseline") or ""), escape(number(result.get("baseline_value"))), escape(ratio),
            escape(result.get("target") or ""), verdict(result.get("met"))]


def results(list_of_results):
    heads = ["figure", "value", "unit", "beside", "theirs", "ratio (of rounds)", "target", "", "rounds", "spread"]
    rows = [_figures(result) + [escape(number(result.get("rounds"))), escape(number(result.get("spread")))]
            for result in list_of_results]
    return folded(f"All {len(rows)} figures", table(heads, rows), is_open=len(rows) <= SHORT)


def missed(list_of_results, cause_of, anchor):
    """A list of the targets that were missed, with their causes. `cause_of(name)` returns a text or None."""
    heads = ["missed", "value", "unit", "beside", "theirs", "ratio (of rounds)", "target", "", "cause"]
    rows = []
    for result in list_of_results:
        if result.get("met") is not False:
            continue
        cause = cause_of(result.get("name", ""))
        if cause:
            said = inline(cause)
        elif anchor:
            said = f'<a href="#{anchor}">what is known of this benchmark</a>'
        else:
            said = "bench/causes.toml does not say yet"
        rows.append(_figures(result) + [f'<td class="cause">{said}</td>'])
    return table(heads, rows) if rows else ""
