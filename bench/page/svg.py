"""What all pictures share: their size, ground and legend."""

from .markup import element, escape
from .style import PLOT

WIDTH = 520
LETTER = 7.2  # about so wide


def text(x, y, content, anchor=None, class_=None):
    return element("text", escape(content), x=f"{x:.1f}", y=f"{y:.1f}", text_anchor=anchor, class_=class_)


def wrapped(content, width):
    """The words of a text in lines that are about `width` pixels wide."""
    lines = [""]
    for word in str(content).split():
        if lines[-1] and (len(lines[-1]) + 1 + len(word)) * LETTER > width:
            lines.append("")
        lines[-1] += (" " if lines[-1] else "") + word
    return lines


def legend(entries, y):
    """(markup, where it ends) of [(name, sample that is 30 wide)], in rows from `y` on."""
    parts, x = [], 16
    for name, sample in entries:
        width = 38 + len(name) * LETTER + 14
        if x > 16 and x + width > WIDTH:
            x, y = 16, y + 20
        parts += [element("g", sample, transform=f"translate({x:.0f},{y - 4:.0f})"), text(x + 38, y, name)]
        x += width
    return "".join(parts), y + 14


def picture(title, parts, height):
    """`parts` begin at 40 below the top; a title of several lines moves them down."""
    lines = wrapped(title, (WIDTH - 20) * 0.78)  # its letters are wider
    height += 20 * (len(lines) - 1)
    ground = element("rect", class_="ground", width=WIDTH, height=f"{height:.0f}")
    head = "".join(text(WIDTH / 2, 24 + 20 * index, line, "middle", "title") for index, line in enumerate(lines))
    body = element("g", "".join(parts), transform=f"translate(0,{20 * (len(lines) - 1)})")
    return element("svg", element("title", escape(title)) + ground + head + body,
                   xmlns="http://www.w3.org/2000/svg", class_="plot", role="img", viewBox=f"0 0 {WIDTH} {height:.0f}")


def standalone(svg):
    """The picture as a file of its own: it brings its colours with it, and a ground to stand on."""
    head, _, rest = svg.partition(">")
    return f"{head} width=\"{WIDTH * 1.25:.0f}\">{element('style', PLOT)}{rest}\n"
