"""Why targets are missed, read from bench/causes.toml.

The file has a list for each benchmark, such as `[[runtime]]`. An item's `why` is the cause for all results whose
name has all words of the item's `results`; an item without `results` is about the benchmark as a whole.
"""

import re
import tomllib

from .markup import element, escape, slug

_WORD = re.compile(r"[^\s,:]+")
_CODE = re.compile(r"`([^`]+)`")


class Causes:
    def __init__(self, text):
        """Raises ValueError when the text is no TOML, or when an item has no `why` or an unknown key."""
        self.items = tomllib.loads(text)  # {benchmark: [{"results": .., "why": ..}]}
        for bench, items in self.items.items():
            for item in items:
                if not isinstance(item, dict) or "why" not in item or item.keys() - {"results", "why"}:
                    raise ValueError(f"an item of {bench} has a why, and may have results; this one has: {item}")

    def of(self, bench, result):
        """Why this result missed its target: the `why` of the item that matches with the most words; None when none
        does."""
        best, most = None, 0
        name = result.lower()
        for item in self.items.get(bench, []):
            words = _WORD.findall(item.get("results", "").lower())
            if len(words) > most and all(word in name for word in words):
                best, most = item["why"], len(words)
        return best

    def anchor(self, bench):
        """The page's anchor of this benchmark's items; None when it has none."""
        return f"why-{slug(bench)}" if bench in self.items else None

    def markup(self):
        """All items as HTML, benchmark by benchmark."""
        parts = []
        for bench, items in self.items.items():
            told = "".join(element("li", (f"<i>{escape(item['results'])}</i>: " if "results" in item else "") + inline(item["why"]))
                           for item in items)
            parts.append(element("div", element("h3", escape(f"./dev bench {bench}")) + element("ul", told), id=self.anchor(bench)))
        return "".join(parts)


def inline(text):
    """A text as HTML; words between backticks become <code>."""
    return _CODE.sub(r"<code>\1</code>", escape(" ".join(text.split())))
