#!/usr/bin/python3
"""docs/site.py makes one site of all documents, in which all is found."""

import json
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


class Site(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.folder = tempfile.TemporaryDirectory()
        cls.addClassCleanup(cls.folder.cleanup)
        reference = Path(cls.folder.name) / "html"
        reference.mkdir()
        (reference / "index.html").write_text("<html><body>headers</body></html>")
        cls.site = Path(cls.folder.name) / "site"
        subprocess.run([sys.executable, ROOT / "docs/site.py", reference, cls.site], check=True, capture_output=True)

    def test_every_document_is_a_page(self):
        for page in ("index.html", "docs/tutorial.html", "topology/windows/index.html", "tests/chaos/index.html"):
            self.assertTrue((self.site / page).is_file(), page)

    def test_the_search_finds_a_page_by_its_words(self):
        index = json.loads((self.site / "search/search_index.json").read_text())
        found = {entry["location"].split("#")[0] for entry in index["docs"] if "window.idle_source" in entry["text"]}
        self.assertIn("docs/reference/index.html", found)

    def test_the_search_needs_no_server(self):
        self.assertIn('src="../search/from_disk.js"', (self.site / "docs/guide.html").read_text())
        script = (self.site / "search/from_disk.js").read_text()
        begin = "var __search = {index: Promise.resolve("
        self.assertTrue(script.startswith(begin), script[:100])
        index, _ = json.JSONDecoder().raw_decode(script, len(begin))
        self.assertEqual(index, json.loads((self.site / "search/search_index.json").read_text()))
        [worker] = (self.site / "assets/javascripts/workers").glob("search.*.js")
        self.assertIn(json.dumps(worker.read_text()), script)

    def test_the_logo_leads_to_a_page_and_not_to_a_folder(self):
        self.assertIn('href="../index.html" title="IoTCloud"', (self.site / "docs/guide.html").read_text())

    def test_links_to_sources_and_to_folders_lead_somewhere(self):
        self.assertTrue((self.site / "tests/external/project/thermostat.cc").is_file())
        self.assertIn('href="topology/index.html"', (self.site / "index.html").read_text())

    def test_the_reference_of_the_headers_is_in_it(self):
        self.assertIn("headers", (self.site / "api/index.html").read_text())


if __name__ == "__main__":
    unittest.main()
