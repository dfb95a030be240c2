"""Pictures by gnuplot: quotes any text for its language, and makes its SVG fit into a page."""

import re
import subprocess
import xml.etree.ElementTree as ElementTree

from .markup import printable
from .style import PICTURE

WIDTH = 520
LETTER = 7.2  # width of a letter in pixels, about
LIMIT_S = 60
# characters that need no octal number; digits do, because one behind an octal number could count as part of it
SAFE = " .,:;()/+-_="

_SVG = "{http://www.w3.org/2000/svg}"
_LINK = "{http://www.w3.org/1999/xlink}href"
ElementTree.register_namespace("", _SVG[1:-1])
ElementTree.register_namespace("xlink", _LINK[1:].partition("}")[0])


def quoted(text):
    """The text as a gnuplot string of one line: letters stay, the bytes of all other characters become octal numbers."""
    clean = " ".join(printable(text).split()).replace("]]>", "]] >")  # gnuplot writes that as it is, and XML forbids it
    return '"' + "".join(letter if letter.isascii() and letter.isalpha() or letter in SAFE else
                         "".join(f"\\{byte:03o}" for byte in letter.encode()) for letter in clean) + '"'


def wrapped(text, width):
    """Splits a text into lines that are at most about `width` pixels wide."""
    lines = [""]
    for word in printable(text).split():
        if lines[-1] and (len(lines[-1]) + 1 + len(word)) * LETTER > width:
            lines.append("")
        lines[-1] += (" " if lines[-1] else "") + word
    return lines


class Picture:
    """The input of gnuplot: settings, then curves, each a line of its `plot` command. The text of `said` shows when the
    pointer is over a mark."""

    def __init__(self, title, height):
        self._title = printable(title)
        lines = wrapped(title, (WIDTH - 20) * 0.78)  # letters of a title are wider than LETTER
        self.height = height + 20 * (len(lines) - 1)
        self._settings = ["set title " + '."\\n".'.join(map(quoted, lines)) + " font ',15'",
                          "set key bmargin center spacing 1.2"]
        self._curves = ["NaN notitle"]  # gnuplot must plot something
        self._of_curves, self._said = [None], []

    def set(self, *settings):
        self._settings += [f"set {setting}" for setting in settings]

    def block(self, rows):
        """Adds rows of numbers and returns their name, which a curve uses as its data."""
        name = f"$rows{len(self._settings)}"
        self._settings.append("\n".join([f"{name} << EOD", *(" ".join(map(str, row)) for row in rows), "EOD"]))
        return name

    def said(self, text):
        """The name that stands in gnuplot's input for the text of a mark."""
        self._said.append(printable(text))
        return f"said-{len(self._said) - 1}"

    def curve(self, curve, said=None):
        self._curves.append(curve)
        self._of_curves.append(said and printable(said))

    def svg(self, name):
        """Runs gnuplot. Returns an svg element whose ids begin with `name`. Raises RuntimeError with gnuplot's own
        message."""
        script = "\n".join(["set encoding utf8", f'set terminal svg size {WIDTH},{self.height} dynamic noenhanced '
                            f'font "sans-serif,13"', *self._settings,
                            f"plot {', '.join(self._curves)}", ""])
        done = subprocess.run(["gnuplot"], input=script.encode(), capture_output=True, timeout=LIMIT_S)
        if done.returncode != 0:
            raise RuntimeError(f"gnuplot: {done.stderr.decode(errors='replace').strip()}")
        return self._tidied(done.stdout.decode(), name)

    def _tidied(self, text, name):
        """Removes scripts, adds titles with the marks' texts, and makes ids unique on a page with many pictures."""
        text = re.sub(r"rgb\(\s*(\d+),\s*(\d+),\s*(\d+)\)", lambda found: "#%02x%02x%02x" % tuple(map(int, found.groups())), text)
        text = re.sub(r"gp(?=Pt|Dot)", f"{name}-gp", text)
        tree = ElementTree.fromstring(text)
        tree.attrib |= {"class": "plot", "role": "img"}
        tree.find(f"{_SVG}title").text = self._title
        tree.remove(tree.find(f"{_SVG}desc"))
        for definitions in tree.iter(f"{_SVG}defs"):
            for filters in definitions.findall(f"{_SVG}filter"):
                definitions.remove(filters)
        for group in tree.iter(f"{_SVG}g"):
            self._titled(group, name)
        return ElementTree.tostring(tree, encoding="unicode")

    def _titled(self, group, name):
        said = re.search(r"'said-(\d+)'", group.attrib.pop("onmousemove", ""))
        group.attrib.pop("onmouseout", None)
        if group.get("id") == "gnuplot_canvas":
            del group.attrib["id"]
        title = group.find(f"{_SVG}title")
        if title is None:
            return
        if curve := re.fullmatch(r"gnuplot_plot_(\d+)", group.get("id", "")):
            group.set("id", f"{name}-curve-{curve[1]}")
            title.text = self._of_curves[int(curve[1]) - 1]
        elif said:
            title.text = self._said[int(said[1])]
        if not title.text:
            group.remove(title)


def standalone(svg):
    """The picture as a file of its own, with its colours and a background."""
    head, _, rest = svg.partition(">")
    ground = '<rect class="ground" width="100%" height="100%"/>'
    return f'{head} width="{WIDTH * 1.25:.0f}"><style>{PICTURE}</style>{ground}{rest}\n'
