"""Writes build/bench/report.html and the plots beside it from all JSON files that are there."""

import json
import math
import os
from datetime import datetime, timezone
from pathlib import Path

from . import tables
from .causes import Causes
from .gnuplot import standalone
from .markup import count, element, escape, number, slug
from .plots import draw
from .style import PAGE, PICTURE

CAUSES = Path(__file__).resolve().parent.parent / "causes.toml"
MACHINE = {"cpu": "CPU", "cores": "cores", "memory_mb": "memory (MB)", "kernel": "kernel",
           "load_average_before": "load before", "load_average_after": "load after"}


def name_of(folder, file):
    """The name of the section for this file of `folder`; the names of its pictures begin with it."""
    return slug(file.stem if file.parent != folder else f"bench-{file.stem}")


class Section:
    """The section of the page for one JSON file."""

    def __init__(self, folder, file, causes):
        self.file, self.link = file, file.relative_to(folder).as_posix()
        self.is_paper = file.parent != folder
        self.name = name_of(folder, file)
        self.causes, self.bench = causes, "paper" if self.is_paper else file.stem
        if self.is_paper and file.stem in causes.items:
            self.bench = file.stem
        self.broken = None
        try:
            self.data = json.loads(file.read_text(encoding="utf-8"))
            self.results, self.plots = self.data["results"], self.data.get("plots", [])
            self.drawn = [draw(plot, f"{self.name}-{index}") for index, plot in enumerate(self.plots, 1)]
            self.body = self._body()
        except (OSError, RuntimeError, ValueError, LookupError, TypeError, AttributeError) as error:
            # A file that cannot be shown must not prevent the sections of the others.
            self.broken, self.data, self.results, self.plots, self.drawn = error, {}, [], [], []

    @property
    def title(self):
        figure, title = self.data.get("figure"), self.data.get("title")
        if title and str(figure or "")[:1].isdigit():
            return f"Figure {figure}: {title}"
        return title or f"./dev bench {self.file.stem}"

    def judged(self):
        """{name: met}. `results` has a figure once for each baseline; its target counts as met when it is met for all
        of them."""
        met = {}
        for result in self.results:
            if result.get("met") is not None:
                met[result["name"]] = met.get(result["name"], True) and result["met"]
        return met

    def failures(self):
        return sum("failed" in point for plot in self.plots for series in plot["series"] for point in series["points"])

    def summary(self):
        if self.broken:
            return '<span class="missed">cannot be read</span>'
        met = self.judged().values()
        said = f"{sum(met)} of {len(met)} targets met" if met else "no targets"
        failed = f", {count(self.failures(), 'point')} failed" if self.failures() else ""
        failed += ", FAILED" if self.data.get("failed") else ""
        kind = "missed" if failed or not all(met) else "met" if met else "soft"
        return f'<span class="{kind}">{said}{failed}</span>'

    def taken(self):
        if self.data.get("taken"):
            return str(self.data["taken"])
        return datetime.fromtimestamp(self.file.stat().st_mtime, timezone.utc).isoformat(timespec="seconds") + " (the file)"

    def is_quick(self):
        return self.data.get("quick", "--quick" in str(self.data.get("command", "")))

    def _provenance(self):
        machine, versions = self.data.get("machine") or {}, self.data.get("versions") or {}
        seconds = self.data.get("seconds")
        facts = [("taken", self.taken() + (f", in {number(seconds)} s" if seconds else "")),
                 ("run", str(self.data.get("scale", "quick" if self.is_quick() else "full"))), ("command", self.data.get("command", "not said")),
                 ("commit", self.data.get("commit", "not said"))]
        facts += [(title, number(machine[key])) for key, title in MACHINE.items() if key in machine]
        facts += [(key, number(value)) for key, value in versions.items()]
        rows = [[tables.name_cell(key), tables.name_cell(value)] for key, value in facts]
        return tables.folded(f"Taken {self.taken()}{', a quick run' if self.is_quick() else ''}: command, commit, machine, "
                             "versions", tables.table(["", ""], rows))

    def _body(self):
        parts = []
        if self.data.get("failed"):
            parts.append(f'<p class="missed">FAILED: {escape(self.data["failed"])}</p>')
        if self.is_quick():
            parts.append('<p class="missed">A quick run: few rounds, so single figures may be off.</p>')
        if self.drawn:
            parts.append('<div class="plots">' + "".join(self._figure(*each) for each in self.drawn) + "</div>")
        missed = tables.missed(self.results, lambda name: self.causes.of(self.bench, name), self.causes.anchor(self.bench))
        parts += [missed, tables.results(self.results) if self.results else ""]
        parts += [tables.points(plot) for plot in self.plots if plot.get("style") != "dots"]
        parts.append(self._provenance())
        return "".join(parts)

    @staticmethod
    def _figure(svg, notes):
        said = "".join(f'<li class="{"missed" if "FAILED" in note else "soft"}">{escape(note)}</li>' for note in notes)
        return f"<figure>{svg}{f'<figcaption><ul>{said}</ul></figcaption>' if said else ''}</figure>"

    def markup(self):
        raw = element("a", escape(self.link), href=self.link)
        if self.broken:
            what = escape(f"{type(self.broken).__name__}: {self.broken}")
            return (f'<section id="{self.name}"><h2>{escape(self.link)}</h2><p class="missed">This file cannot be shown: '
                    f"{what}. Run its benchmark again. Raw: {raw}</p></section>")
        return (f'<section id="{self.name}"><h2>{escape(self.title)}</h2><p>{self.summary()}. Raw: {raw}</p>'
                f"{self.body}</section>")


def sections(folder, causes):
    """The paper's figures in the order of their numbers, then the rest by name."""
    def order(file):
        digits = "".join(filter(str.isdigit, file.stem))
        return int(digits) if digits else math.inf, file.stem

    paper = sorted((folder / "paper").glob("*.json"), key=order)
    return [Section(folder, file, causes) for file in [*paper, *sorted(folder.glob("*.json"))]]


def machines(all_sections):
    """The machines, commits and versions of the figures; there are several if figures were taken again later."""
    found = {}
    for section in all_sections:
        machine = section.data.get("machine") or {}
        facts = {title: number(machine[key]) for key, title in MACHINE.items() if key in machine and "load" not in key}
        facts |= {"commit": section.data.get("commit"), **(section.data.get("versions") or {})}
        for key, value in facts.items():
            if value:
                found.setdefault(key, {}).setdefault(str(value), []).append(section.name)
    rows = []
    for key, values in found.items():
        said = "; ".join(value if len(values) == 1 else f"{value} ({', '.join(names)})" for value, names in values.items())
        rows.append([tables.name_cell(key), tables.name_cell(said)])
    return tables.table(["", ""], rows) if rows else ""


def page(folder, causes):
    """Returns (the page's HTML, {name: svg})."""
    causes = Causes(causes)
    shown = sections(folder, causes)
    met = [met for section in shown for met in section.judged().values()]
    failed = sum(section.failures() for section in shown)
    links = "".join(f'<li><a href="#{section.name}">{escape(section.link if section.broken else section.title)}</a>: '
                    f"{section.summary()}</li>" for section in shown)
    now = datetime.now(timezone.utc).isoformat(timespec="seconds")
    body = (
        "<h1>IoTCloud: what was measured</h1>"
        f"<p>{sum(met)} of {len(met)} targets are met"
        f"{'; ' + count(failed, 'point') + ' failed' if failed else ''}. Written {now}. bench/README.md says how the figures are taken.</p>"
        f"<nav><ul>{links or '<li>There are no figures yet: run ./dev bench paper</li>'}</ul></nav>"
        f"{machines(shown)}{''.join(section.markup() for section in shown)}"
        f'<section id="why"><h2>Why targets are missed</h2>{causes.markup()}</section>')
    document = (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"/>'
        '<meta name="viewport" content="width=device-width,initial-scale=1"/>'
        '<meta name="color-scheme" content="light dark"/><title>IoTCloud: what was measured</title>'
        f"<style>{PAGE}{PICTURE}</style></head><body>{body}</body></html>\n")
    return document, _pictures(shown)


def _pictures(all_sections):
    return {f"{section.name}-{index}": standalone(svg)
            for section in all_sections for index, (svg, _) in enumerate(section.drawn, 1)}


def put(file, text):
    """Writes a file by way of a rename, so that a reader never sees a part of it."""
    new = file.with_name(f".{file.name}.new")
    new.write_text(text, encoding="utf-8")
    os.replace(new, file)


def _put_pictures(folder, pictures):
    """Writes these pictures to `folder`/plots and removes all others there."""
    plots = folder / "plots"
    plots.mkdir(parents=True, exist_ok=True)
    for name, svg in pictures.items():
        put(plots / f"{name}.svg", svg)
    for old in plots.glob("*.svg"):
        if old.stem not in pictures:
            old.unlink()


def write_pictures(folder):
    """Writes the pictures of all JSON files of `folder` to `folder`/plots, without a page. If drawing one of them
    raises, nothing is written."""
    shown = sections(folder, Causes(""))
    for section in shown:
        if section.broken:
            raise section.broken
    _put_pictures(folder, _pictures(shown))


def write(folder, causes=CAUSES):
    """Writes `folder`/report.html and `folder`/plots/*.svg. Returns the page's path."""
    folder = Path(folder)
    document, pictures = page(folder, Path(causes).read_text(encoding="utf-8"))
    _put_pictures(folder, pictures)
    put(folder / "report.html", document)
    return folder / "report.html"
