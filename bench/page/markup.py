"""Text for HTML and SVG, which any name or message may be put into."""

import re

# What XML cannot hold, whatever it is written as.
_IMPOSSIBLE = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def escape(text):
    text = _IMPOSSIBLE.sub("\ufffd", str(text))
    for character, entity in (("&", "&amp;"), ("<", "&lt;"), (">", "&gt;"), ('"', "&quot;")):
        text = text.replace(character, entity)
    return text


def element(name, content="", **attributes):
    """`content` is markup already; attributes are text. An underscore in a name stands for a hyphen, at the end for
    nothing (class_); one that is None is left out."""
    words = "".join(f' {key.rstrip("_").replace("_", "-")}="{escape(value)}"' for key, value in attributes.items()
                    if value is not None)
    return f"<{name}{words}>{content}</{name}>" if content else f"<{name}{words}/>"


def slug(text):
    return re.sub("[^a-z0-9]+", "-", str(text).lower()).strip("-")


def number(value):
    """Three digits; large ones whole. What is no number is said as it is."""
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
    """For an axis: 1000 as 1k."""
    for factor, letter in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if abs(value) >= factor:
            return f"{value / factor:.3g}{letter}"
    return f"{value:.3g}"
