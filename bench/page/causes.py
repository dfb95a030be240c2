"""What bench/README.md says of targets that are missed, and the little of Markdown that this takes.

A section begins with "Of `./dev bench NAME`" (the first of them with "**What is missed, and why**") and ends where the
next one begins. In it each item tells the cause of the results in whose name all words of its first *emphasis* are.
"""

import re

from .markup import escape, slug

_BEGIN = re.compile(r"^Of `\./dev bench|^\*\*What is missed, and why\*\*", re.M)
_WORD = re.compile(r"[^\s,:*]+")


class Causes:
    def __init__(self, readme):
        begins = [found.start() for found in _BEGIN.finditer(readme)] + [len(readme)]
        self.sections = {}  # {NAME: its text}
        for begin, end in zip(begins, begins[1:]):
            section = readme[begin:end].strip()
            head = section.split("\n")[0].split(":")[0]
            for name in re.findall(r"`\./dev bench (\w+)[^`]*`", head) or ["runtime"]:
                self.sections[name] = section

    def of(self, bench, result):
        """The item that names this result with the most words, as Markdown; None when there is none."""
        best, most = None, 0
        name = result.lower()
        for item in items(self.sections.get(bench, "")):
            emphasis = re.search(r"\*([^*]+)\*", item)
            words = _WORD.findall(emphasis[1].lower()) if emphasis else []
            if len(words) > most and all(word in name for word in words):
                best, most = item, len(words)
        return best

    def distinct(self):
        """[(name, section)]: one that is of two benchmarks once."""
        return [(names[0], text) for text, names in self._names().items()]

    def anchor(self, bench):
        """Where the page shows the section of this benchmark; None when there is none."""
        return f"why-{slug(self._names()[self.sections[bench]][0])}" if bench in self.sections else None

    def _names(self):
        names = {}
        for name, text in self.sections.items():
            names.setdefault(text, []).append(name)
        return names


def items(section):
    """The items of the section's lists, each in one line."""
    found = []
    for line in section.split("\n"):
        if line.startswith("- "):
            found.append(line[2:])
        elif found and line.startswith("  "):
            found[-1] += " " + line.strip()
    return found


def inline(text):
    """`code`, **strong** and *emphasis* of a line as markup."""
    pieces = re.split(r"(`[^`]+`)", text)
    markup = ""
    for piece in pieces:
        if piece.startswith("`") and len(piece) > 1:
            markup += f"<code>{escape(piece[1:-1])}</code>"
            continue
        piece = re.sub(r"\[([^\]]+)\]\([^)]+\)", r"\1", piece)  # links lead nowhere from here
        piece = re.sub(r"\*\*([^*]+)\*\*", r"<b>\1</b>", escape(piece))
        markup += re.sub(r"\*([^*]+)\*", r"<i>\1</i>", piece)
    return markup


def markup(section):
    """Paragraphs, lists and tables of a section as markup."""
    blocks = []  # [kind, lines]
    for line in section.split("\n"):
        kind = "item" if line.startswith("- ") else "row" if line.startswith("|") else "text" if line.strip() else ""
        if blocks and kind == "text" and (blocks[-1][0] == "text" or line.startswith("  ")) and blocks[-1][0]:
            blocks[-1][1] += " " + line.strip()
        else:
            blocks.append([kind, line[2:] if kind == "item" else line.strip()])
    parts, within = [], ""
    lists = {"item": "ul", "row": "table"}
    for kind, line in blocks:
        if kind != within:
            if within in lists:
                parts.append(f"</{lists[within]}>")
            if kind in lists:
                parts.append(f"<{lists[kind]}>")
        if kind == "item":
            parts.append(f"<li>{inline(line)}</li>")
        elif kind == "text":
            parts.append(f"<p>{inline(line)}</p>")
        elif kind == "row" and not re.fullmatch(r"[|\s:-]+", line):
            cells = "".join(f"<td>{inline(cell.strip())}</td>" for cell in line.strip("|").split("|"))
            parts.append(f"<tr>{cells}</tr>")
        within = kind
    if within in lists:
        parts.append(f"</{lists[within]}>")
    return "".join(parts)
