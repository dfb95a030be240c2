#!/usr/bin/python3
"""docs/links.py finds the links of a site that lead nowhere, and no others."""

import sys
import tempfile
import unittest
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "docs"))

import links  # noqa: E402


class Links(unittest.TestCase):
    def problems(self, body):
        with tempfile.TemporaryDirectory() as folder:
            site = Path(folder) / "site"
            (site / "guide").mkdir(parents=True)
            (Path(folder) / "beside.html").write_text("<p>not installed</p>")
            (site / "picture.png").write_bytes(b"\x89PNG")
            (site / "guide/index.html").write_text('<h2 id="first">1</h2><a name=second></a>')
            (site / "page.html").write_text(f'<html><h1 id="top">Page</h1>{body}</html>')
            return links.Folder(site).problems()

    def test_links_that_lead_somewhere_are_good(self):
        found, count = self.problems('<a href="guide/index.html#first">a</a> <a class="x" href=\'guide/index.html#second\'>b</a> '
                                     '<a href="#top">c</a> <img src=picture.png> <a href="guide/index.html?q=a#first">d</a>')
        self.assertEqual((found, count), ([], 5))

    def test_what_is_elsewhere_or_in_a_script_is_no_link_of_the_site(self):
        found, count = self.problems('<a href="https://example.org/nowhere">a</a> <a href="mailto:a@b">b</a> <a href="#">c</a> '
                                     "<script>s = '<a href=\"nowhere.html\">'</script> <!-- <a href=\"gone.html\"> -->")
        self.assertEqual((found, count), ([], 0))

    def test_links_that_lead_nowhere_are_named_with_their_page(self):
        for link, why in (("gone.html", "no such file"), ("guide/index.html#third", "no such section"),
                          ("#bottom", "no such section"), ("guide", "leads to a folder"),
                          ("../beside.html", "leads out"), ("/page.html", "leads out"), ("pictur&#101;.jpg", "no such file")):
            with self.subTest(link):
                found, _ = self.problems(f'<a href="{link}">x</a>')
                self.assertEqual(len(found), 1, found)
                self.assertTrue(found[0].startswith("page.html: ") and why in found[0], found)

    def test_a_script_that_is_not_there_is_found(self):
        self.assertEqual(self.problems('<script src="search.js"></script>')[0], ["page.html: search.js: there is no such file"])

    def test_a_folder_without_any_link_is_an_error(self):
        with tempfile.TemporaryDirectory() as folder, self.assertRaises(SystemExit):
            links.check(folder)


if __name__ == "__main__":
    unittest.main()
