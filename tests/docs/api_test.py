#!/usr/bin/python3
"""docs/api.py finds what it is there to find, and nothing else."""

import sys
import tempfile
import unittest
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "docs"))

import api  # noqa: E402


class PublicHeaders(unittest.TestCase):
    def problems(self, text):
        with tempfile.TemporaryDirectory() as folder:
            include = Path(folder) / "include"
            header = include / "iotcloud/meters/meter.h"
            header.parent.mkdir(parents=True)
            header.write_text(f"#pragma once\n/// Meters.\nnamespace meters {{\n{text}\n}}\n")
            output = Path(folder) / "out"
            found = api.run_doxygen([header], include, output) + api.undescribed(output, include)
            return [problem.removeprefix("iotcloud/meters/") for problem in found]

    def test_what_is_described_is_good(self):
        self.assertEqual(self.problems("/// Reads it (docs/wire.md#topics).\nstruct Meter {\n  struct Options { int rate; };\n"
                                       "  int value() const;\n private:\n  struct Impl { int x; };\n};\n"
                                       "/// How it is.\nenum class State { on, off };\n/// Of all.\nint sum(int);\nint sum(double);\nint product(int);\n"
                                       "namespace detail { struct Hidden {}; }"), [])

    def test_a_class_an_enumeration_and_a_function_without_words_are_named(self):
        self.assertEqual(self.problems("struct Meter { int value; };\nenum class State { on };\n\nint sum();"),
                         ["meter.h:4: meters::Meter is not described", "meter.h:5: meters::State is not described",
                          "meter.h:7: meters::sum is not described"])

    def test_what_doxygen_does_not_understand_is_an_error(self):
        [problem] = self.problems("/// Stands at /meters/<id>.\nstruct Meter {};")
        self.assertIn("meter.h:4: ", problem)
        self.assertIn("<id>", problem)

    def test_a_parameter_that_is_not_there_is_an_error(self):
        self.assertIn("argument 'rate'", " ".join(self.problems("/// Reads.\n/// \\param rate in Hz.\nint read(int hertz);")))


if __name__ == "__main__":
    unittest.main()
