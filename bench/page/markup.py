"""Makes HTML and SVG from any text: names and messages are escaped."""

import re

# Characters that XML does not allow, not even as entities.
_IMPOSSIBLE = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def printable(text):
    return _IMPOSSIBLE.sub("\ufffd", str(text))


def escape(text):
    text = printable(text)
    for character, entity in (("&", "&amp;"), ("<", "&lt;"), (">", "&gt;"), ('"', "&quot;")):
        text = text.replace(character, entity)
    return text


def element(name, content="", **attributes):
    """An element. `content` is markup already; attributes are text. An underscore in an attribute's name becomes a
    hyphen; one at the end is removed (class_). An attribute whose value is None is left out."""
    words = "".join(f' {key.rstrip("_").replace("_", "-")}="{escape(value)}"' for key, value in attributes.items()
                    if value is not None)
    return f"<{name}{words}>{content}</{name}>" if content else f"<{name}{words}/>"


def slug(text):
    return re.sub("[^a-z0-9]+", "-", str(text).lower()).strip("-")


def number(value):
    """A number with three digits, or whole if it is large; anything else as text."""
    if value is None:
        return ""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return str(value)
    if value != value or value in (float("inf"), float("-inf")):
        return str(value)
    if abs(value) >= 100 or value == int(value):
        return f"{value:,.0f}"
    return f"{value:.0e}" if abs(value) < 0.001 else f"{value:.3g}"


def count(many, what):
    return f"{many} {what}" + ("" if many == 1 else "s")


def short(value):
    """A number for an axis: 1000 becomes 1k."""
    for factor, letter in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if abs(value) >= factor:
            return f"{value / factor:.3g}{letter}"
    return f"{value:.3g}"
