#!/usr/bin/python3
"""Tests which public headers development/headers.py takes for broken by a change."""
import sys
import tempfile
import unittest
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "development"))

import headers  # noqa: E402

ALL = ["brokers/broker.h", "brokers/message.h", "config/error.h", "rpc/session.h"]


class HeadersTest(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory(prefix="iotcloud-headers-")
        self.addCleanup(folder.cleanup)
        tree = Path(folder.name)
        for file, includes in (("brokers/broker.h", ["brokers/message.h"]), ("brokers/message.h", ["config/private.h"]),
                               ("config/private.h", ["config/error.h"]), ("config/error.h", []),
                               ("rpc/session.h", [])):
            (tree / file).parent.mkdir(exist_ok=True)
            (tree / file).write_text("".join(f"#include <iotcloud/{include}>\n" for include in ["gone.h", *includes]))
        self.includes = headers.Includes(tree)

    def affected(self, *changed):
        return headers.affected(ALL, set(changed), self.includes)

    def test_a_header_that_includes_what_changed_through_others_is_affected(self):
        self.assertEqual(self.affected("config/error.h"), ["brokers/broker.h", "brokers/message.h", "config/error.h"])
        self.assertEqual(self.affected("config/private.h"), ["brokers/broker.h", "brokers/message.h"])
        self.assertEqual(self.affected("rpc/session.cc", "README.md"), [])

    def test_a_folders_cmake_file_affects_its_headers_and_the_common_ones_all(self):
        self.assertEqual(self.affected("brokers/CMakeLists.txt"), ["brokers/broker.h", "brokers/message.h"])
        for file in ("CMakeLists.txt", "cmake/IotcloudTargets.cmake", "discovery/records.thrift"):
            self.assertEqual(self.affected(file), ALL)

    def test_targets_are_found_in_ninjas_list(self):
        line = ("a/CMakeFiles/x_verify_interface_header_sets.dir/x_verify_interface_header_sets/iotcloud/a/b.h.cxx.o: "
                "CXX_COMPILER__x\n")
        self.assertEqual([header for _, header in headers.TARGET.findall("all: phony\n" + line)], ["a/b.h"])


if __name__ == "__main__":
    unittest.main()
