#!/usr/bin/python3
"""The report's page and plots, of made-up figures; nothing is measured."""
import json
import re
import tempfile
import unittest
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import page
import versions
from page import style
from page.causes import Causes

CAUSES = '''
[[runtime]]
results = "word count, at most"
why = "The words' own `work & more` takes it."

[[paper]]
results = "1 MB, mean"
why = "The cause of the large ones."
[[paper]]
results = "mean"
why = """
A cause of any mean,
in two lines."""
[[paper]]
why = "What is <so> in all."
'''
NASTY = 'a <b> & "c" \x00\ud800 d'
MACHINE = {"cpu": "Some <CPU> & co", "cores": 2, "memory_mb": 24000, "kernel": "6.1", "load_average_before": 0.1}


def result(name, met, target="<= 1.2 x"):
    return {"name": name, "value": 1.5, "unit": "ms", "baseline": "librabbitmq", "baseline_value": 1.0, "ratio": 1.5,
            "ratio_spread": [1.4, 1.6], "target": target, "met": met, "rounds": 3, "spread": 0.1}


def point(x, mean):
    return {"x": x, "mean_ms": mean, "p50_ms": mean, "p99_ms": 3 * mean, "max_ms": 9 * mean, "stddev_ms": mean / 2,
            "n": 800, "lost": 0}


def curves(*series, **more):
    return {"title": "Mean", "x": "size", "x_unit": "B", "x_log": True, "y": "mean", "y_unit": "ms", "y_log": True,
            "statistic": "mean_ms", "series": list(series), **more}


def series(name, kind, *points):
    return {"name": name, "kind": kind, "points": list(points)}


class PageTest(unittest.TestCase):
    def setUp(self):
        temporary = tempfile.TemporaryDirectory()
        self.addCleanup(temporary.cleanup)
        self.folder = Path(temporary.name)
        (self.folder / "paper").mkdir()
        self.causes = self.folder / "causes.toml"
        self.causes.write_text(CAUSES)

    def figure(self, file="paper/figure-7.json", results=(), plots=(), **more):
        data = {"machine": MACHINE, "commit": "abc123", "command": "./dev bench paper --figure 7", "figure": "7",
                "title": "size & latency", "taken": "2026-11-22T13:00:00+00:00", "quick": False,
                "versions": {"RabbitMQ": "3.10.8"}, "results": list(results), "plots": list(plots), **more}
        (self.folder / file).write_text(json.dumps(data))

    def written(self):
        """The page, after a look at what must hold for any."""
        text = page.write(self.folder, self.causes).read_text()
        tree = ElementTree.fromstring(text)  # well-formed
        for each in tree.iter():
            self.assertNotIn(each.tag.split("}")[-1], ("script", "link", "img", "image", "iframe"))
            self.assertIsNone(each.get("src"))
            self.assertEqual([name for name in each.keys() if name.startswith("on")], [])
            for link in ("href", "{http://www.w3.org/1999/xlink}href"):
                if each.get(link):
                    self.assertRegex(each.get(link), r"^(#|[\w./-]+\.json$)")
        self.assertNotRegex(text, r"@import|url\(|@font-face")
        identities = [each.get("id") for each in tree.iter() if each.get("id")]
        self.assertEqual(len(identities), len(set(identities)))
        for target in re.findall(r'href="#([^"]+)"', text):
            self.assertIn(target, identities)
        for plot in (self.folder / "plots").glob("*.svg"):
            ElementTree.parse(plot)
        return text

    def plot(self, name="figure-7-1"):
        return (self.folder / f"plots/{name}.svg").read_text()

    def titles(self, name="figure-7-1"):
        """What a picture's marks say."""
        tree = ElementTree.fromstring(self.plot(name))
        return [title.text for title in tree.iter("{http://www.w3.org/2000/svg}title")][1:]  # the first is the picture's

    def test_without_figures_it_says_how_to_take_them(self):
        self.assertIn("run ./dev bench paper", self.written())

    def test_says_where_figures_are_from(self):
        self.figure(quick=True, seconds=42)
        (self.folder / "runtime.json").write_text(json.dumps(
            {"machine": MACHINE, "commit": "def456", "command": "./dev bench runtime", "results": []}))
        text = self.written()
        for said in ("Some &lt;CPU&gt; &amp; co", "abc123 (figure-7); def456 (bench-runtime)", "3.10.8", "in 42 s",
                     "2026-11-22T13:00:00+00:00", "./dev bench paper --figure 7", "Figure 7: size &amp; latency",
                     'href="paper/figure-7.json"', 'href="runtime.json"', "A quick run", ", a quick run: command"):
            self.assertIn(said, text)

    def test_a_missed_target_is_marked_with_its_cause(self):
        self.figure(results=[result("figure 7, 100 B: mean", False), result("figure 7, 1 MB: mean", False),
                             result("figure 7, 1 KB: mean", True), result("figure 7, 1 KB: n", None, None)])
        text = self.written()
        self.assertIn("1 of 3 targets met", text)
        self.assertEqual(text.count(">MISSED<"), 4)  # each there, and in the table of all
        cause = re.search(r"figure 7, 100 B: mean.*?class=\"cause\">(.*?)</td>", text)[1]
        self.assertEqual(cause, "A cause of any mean, in two lines.")
        self.assertIn('class="cause">The cause of the large ones.</td>', text)

    def test_a_missed_target_without_cause_leads_to_what_is_said_or_says_so(self):
        self.figure(results=[result("figure 7: p99", False)])
        (self.folder / "brokers.json").write_text(json.dumps({"results": [result("kafka, p50", False)]}))
        text = self.written()
        self.assertIn('<td class="cause"><a href="#why-paper">', text)
        self.assertIn("bench/causes.toml does not say yet", text)
        self.assertIn("<li>What is &lt;so&gt; in all.</li>", text)
        self.assertIn("<li><i>word count, at most</i>: The words' own <code>work &amp; more</code> takes it.</li>", text)

    def test_a_cause_that_nobody_would_read_is_refused(self):
        for text in ('[[paper]]\nresults = "mean"', '[[paper]]\nwhy = "a"\nfigures = "b"', 'paper = ["a"]', "no toml"):
            with self.assertRaises(ValueError):
                Causes(text)

    def test_the_projects_own_causes_can_be_read(self):
        self.assertIn("runtime", Causes(page.page.CAUSES.read_text()).items)

    def test_a_figure_that_misses_one_of_its_targets_is_missed(self):
        self.figure(results=[result("p99", False), result("p99", True)])
        self.assertIn("0 of 1 targets met", self.written())

    def test_a_failed_point_is_shown_with_its_cause(self):
        self.figure(plots=[curves(series("IoTCloud", "ours", point(100, 0.5),
                                         {"x": 1000, "failed": "256 MB <under> way"}))])
        text = self.written()
        self.assertIn("1 point failed", text)
        self.assertIn("IoTCloud, at 1,000: FAILED: 256 MB &lt;under&gt; way", re.search("<figcaption>.*?</figcaption>", text)[0])
        self.assertIn("IoTCloud, at 1000: FAILED: 256 MB <under> way", self.titles())
        self.assertRegex(text, r'<td class="cause missed" colspan="8">FAILED: 256 MB')

    def test_a_figure_that_was_given_up_says_why(self):
        self.figure(failed="the <server> did not start")
        text = self.written()
        self.assertIn("FAILED: the &lt;server&gt; did not start", text)
        self.assertIn('<span class="missed">no targets, FAILED</span>', text)

    def test_points_without_the_statistic_are_counted_and_not_drawn(self):
        self.figure(plots=[curves(series("IoTCloud", "ours", point(100, 0.5), {"x": 1000, "p99_ms": 2.0},
                                         {"x": 2000, "mean_ms": None}, {"x": 3000, "mean_ms": float("nan")}))])
        self.assertIn("IoTCloud: 3 of 4 points have no mean_ms", self.written())
        self.assertEqual(self.titles(), ["IoTCloud, at 100: 0.5 ms"])

    def test_what_no_logarithm_has_is_said(self):
        self.figure(plots=[curves(series("IoTCloud", "ours", point(100, 0.5), point(1000, 0.0)))])
        self.assertIn("IoTCloud, at 1000: 0 has no place on a logarithmic axis", self.written())

    def test_pairs_have_one_colour_and_kinds_a_style(self):
        self.figure(plots=[curves(series("IoTCloud, 10/s", "ours", point(100, 1), point(200, 2)),
                                  series("librabbitmq, 10/s", "limit", point(100, 1), point(200, 2)),
                                  series("Storm, 100/s", "peer", point(100, 1), point(200, 2)),
                                  series("the paper", "paper", {"x": 100, "mean_ms": 12, "source": "section 5.1"}))])
        text = self.written()
        lines = re.findall(r"<path stroke='(#\w+)'(?:\s+stroke-dasharray='([^']+)')?\s+d='", self.plot().replace('"', "'"))
        blue, red = (colours[0] for colours in style.PALETTE[:2])
        of = {colour: [dashes for stroke, dashes in lines if stroke == colour] for colour in (blue, red)}
        self.assertEqual(len(of[blue]), 2)
        self.assertNotEqual(*of[blue])
        self.assertEqual(len(of[red]), 1)
        self.assertEqual(len({*of[blue], *of[red]}), 3)
        self.assertIn("the paper, at 100: 12 ms (section 5.1)", self.titles())
        self.assertIn("the paper: mean 12 ms (section 5.1)", text)

    def test_bars_of_parts_and_of_what_is_beside(self):
        parts = [series("encode", "part", point(None, 0.5)), series("compute", "part", point(None, 0.25))]
        self.figure(plots=[{"title": "Parts", "bars": ["p50_ms", "p99_ms"], "series": [
            *parts, series("in all", "ours", point(None, 0.8)),
            series("the paper", "paper", {"mean_ms": 33.26, "source": "section 5.4"})]}])
        text = self.written()
        for said in ("p50: its parts", ">0.75<", "p99, in all", ">2.4<", "mean, the paper", ">33.3 \u2192<"):
            self.assertIn(said, self.plot())
        self.assertEqual(self.titles()[:3], ["encode: 0.5 ms", "compute: 0.25 ms", "in all: 0.8 ms"])
        self.assertIn("the paper: mean 33.3 ms (section 5.4)", text)

    def test_names_may_be_anything(self):
        self.figure(title=NASTY, results=[result(NASTY, False)], plots=[curves(
            series(NASTY, "ours", {**point("x<1>", 1), "source": NASTY}, {"x": "x&2", "failed": NASTY}), title=NASTY)])
        text = self.written()
        self.assertIn("a &lt;b&gt; &amp; &quot;c&quot; \ufffd\ufffd d", text)
        self.assertIn("x&lt;1&gt;", text)
        self.assertIn("x&lt;1&gt;", self.plot())

    def test_a_name_is_no_word_of_gnuplots(self):
        there = self.folder / "there"
        for name in (f"`touch {there}`", f"'; !touch {there}\n!touch {there}; '", f'"; system("touch {there}"); "', "@macro %s \\n {/Bold b}",
                     "EOD\n!touch there", "]]>"):
            self.figure(title=name, plots=[
                curves(series(name, "ours", point(name, 1)), title=name, x=name, y=name),
                {"title": name, "bars": ["p50_ms"], "series": [series(name, "part", {"p50_ms": 1})]}])
            self.assertNotIn("cannot be shown", self.written())
            shown = [text.text for text in ElementTree.fromstring(self.plot()).iter("{http://www.w3.org/2000/svg}text")]
            self.assertIn(" ".join(name.split()).replace("]]>", "]] >"), [text.strip() for text in shown])
        self.assertFalse(there.exists())

    def test_a_file_that_cannot_be_read_costs_only_itself(self):
        for name, text in (("half", '{"results": ['), ("list", "[]"), ("plots", '{"results": [], "plots": [{}]}')):
            (self.folder / f"{name}.json").write_text(text)
        self.figure(results=[result("mean", True)])
        text = self.written()
        self.assertEqual(text.count("This file cannot be shown"), 3)
        self.assertIn("1 of 1 targets are met", text)

    def test_figures_stand_in_order_and_plots_of_none_are_removed(self):
        for number in ("10", "7a", "7", "12"):
            self.figure(f"paper/figure-{number}.json", figure=number, plots=[curves(series("a", "ours", point(1, 1)))])
        self.figure("paper/storm.json", figure="storm", title="Beside Storm")
        self.written()
        (self.folder / "paper/figure-10.json").unlink()
        self.assertEqual(re.findall("<h2>(Figure \\w+|Beside Storm)", self.written()),
                         ["Figure 7", "Figure 7a", "Figure 12", "Beside Storm"])
        self.assertEqual(sorted(file.name for file in (self.folder / "plots").iterdir()),
                         ["figure-12-1.svg", "figure-7-1.svg", "figure-7a-1.svg"])

    def test_a_plot_by_itself_has_its_colours_for_light_and_dark(self):
        self.figure(plots=[curves(series("a", "ours", point(1, 1)))])
        self.written()
        self.assertIn("prefers-color-scheme:dark", self.plot())
        self.assertIn('class="ground"', self.plot())
        for light, dark in style.PALETTE:
            self.assertIn(f'[stroke="{light}" i]{{stroke:{dark}}}', self.plot())

    def test_what_is_no_time_has_its_own_column(self):
        self.figure(plots=[curves(series("IoTCloud", "ours", {"x": "tracked", "per_second": 3e6, "n": 3},
                                         {"x": "untracked", "per_second": 8e6, "n": 3}),
                                  statistic="per_second", y="results a second", y_unit="/s", x="")])
        text = self.written()
        self.assertIn('<th scope="col">results a second</th>', text)
        self.assertIn("<td>8,000,000</td>", text)
        self.assertIn(">untracked</text>", self.plot())

    def test_every_frame_is_a_dot_and_not_a_row(self):
        frames = [{"x": index, "ms": 1.0 + index} for index in range(50)]
        self.figure(plots=[curves(series("a", "ours", *frames), style="dots", statistic="ms", x_log=False)])
        text = self.written()
        marks_in_definitions = self.plot().partition("</defs>")[0].count("<use")
        self.assertEqual(self.plot().count("<use"), marks_in_definitions + 50 + 1)  # and the legend's sample
        self.assertNotIn("The points:", text)


class VersionsTest(unittest.TestCase):
    def test_what_is_not_there_is_left_out(self):
        self.assertEqual(versions.asked("/nowhere"), {})

    def test_a_jar_tells_its_version(self):
        with tempfile.TemporaryDirectory() as folder:
            self.assertIsNone(versions.of_jar(folder, "a-*.jar"))
            (Path(folder) / "a-1.jar").write_bytes(b"no jar")
            self.assertIsNone(versions.of_jar(folder, "a-*.jar"))
            with versions.zipfile.ZipFile(Path(folder) / "a-1.jar", "w") as jar:
                jar.writestr("META-INF/MANIFEST.MF", "Manifest-Version: 1.0\r\nImplementation-Version: 5.18.3\r\n")
            self.assertEqual(versions.of_jar(folder, "a-*.jar"), "5.18.3")


if __name__ == "__main__":
    unittest.main()
