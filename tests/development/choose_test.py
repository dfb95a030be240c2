#!/usr/bin/python3
"""Tests what development/choose.py says that chosen tests need."""
import io
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path
from unittest import mock

TREE = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(TREE / "development"))

import choose  # noqa: E402

OUTBOX = "TEST(Outbox, KeepsOrder) {}\nTEST_F(Ring, IsFull) {}\n"
CONTRACT = "TEST_P(Registry, KeepsWatches) {}\n"


class ChooseTest(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory(prefix="iotcloud-choose-")
        self.addCleanup(folder.cleanup)
        self.build = Path(folder.name)
        (self.build / "outbox_test.cc").write_text(OUTBOX)
        (self.build / "contract_test.cc").write_text(CONTRACT)
        self.listed(("brokers_test", "program", "unit room:brokers asan", "brokers_test", "outbox_test.cc"),
                    ("registry_test", "program", "contract room:discovery", "registry_test", "contract_test.cc"),
                    ("contract_test.kafka", "test", "contract room:brokers java", "contract_test", ""),
                    ("a_person_is_followed", "test", "system room:system", "programs turtle", ""),
                    ("loop_test", "test", "system room:system serverless", "loop_test", ""),
                    ("a_robot_stops", "test", "server room:drivers ros", "", ""),
                    ("chaos", "test", "long room:chaos", "chaos", ""))

    def listed(self, *rows):
        lines = []
        for *words, sources in rows:
            sources, _, missing = sources.partition(" missing: ")
            lines.append("\t".join([*words, " ".join(str(self.build / source) for source in sources.split()), missing]) + "\n")
        (self.build / "test_list.tsv").write_text("".join(lines))

    def chosen(self, *words):
        return choose.choose(self.build, words)

    def test_a_name_in_a_source_chooses_its_program_and_a_unit_test_needs_nothing_else(self):
        self.assertEqual(self.chosen("-L", "^room:brokers$", "-R", "Outbox.Keeps"), (["brokers_test"], []))
        self.assertEqual(self.chosen("-L", "^room:brokers$", "-R", "Ring"), (["brokers_test"], []))
        self.assertEqual(self.chosen("-L", "^room:brokers$", "-R", "Ring", "-E", "IsFull"), ([], []))

    def test_needs_are_those_of_the_chosen_tests_labels(self):
        self.assertEqual(self.chosen("-L", "^room:brokers$", "-R", "contract"), (["contract_test"], ["java", "servers"]))
        self.assertEqual(self.chosen("-R", "followed", "-E", "Keeps"), (["programs", "registry_test", "turtle"],
                                                                        ["servers", "tools"]))
        self.assertEqual(self.chosen("-L", "system", "-R", "loop"), (["loop_test"], ["tools"]))
        self.assertEqual(self.chosen("-L", "^room:drivers$"), ([], ["ros", "servers"]))

    def test_labels_leave_out_and_all_must_fit(self):
        self.assertEqual(self.chosen("-L", "^unit$", "-LE", "^long$"), (["brokers_test"], []))
        self.assertEqual(self.chosen("-L", "brokers", "-L", "asan"), (["brokers_test"], []))
        self.assertEqual(self.chosen("-L", "^long$"), (["chaos"], ["servers", "tools"]))

    def test_a_room_that_is_named_as_a_kind_is_chosen_exactly(self):
        self.listed(("update_test", "test", "system room:deploy", "programs", ""),
                    ("world_test", "test", "unit room:system tsan", "world_test", ""))
        self.assertEqual(self.chosen("-L", "^room:(system)$")[0], ["world_test"])
        self.assertEqual(self.chosen("-L", "^(unit|contract|server|system)$", "-L", "^room:(deploy)$")[0], ["programs"])

    def test_the_names_of_a_parameterized_test_are_known_once_it_was_built(self):
        choice = ("-L", "discovery", "-R", "zookeeper")
        self.assertEqual(self.chosen(*choice)[0], ["registry_test"], "it may have such a test")
        found = self.build / "registry_test[1]_tests.cmake"
        found.write_text('add_test([=[All/Registry.KeepsWatches/embedded]=]  /x/registry_test [==[--gtest_filter=a]==])\n')
        self.assertEqual(self.chosen(*choice)[0], [])
        found.write_text('add_test([=[All/Registry.KeepsWatches/zookeeper]=]  /x/registry_test [==[--gtest_filter=a]==])\n')
        self.assertEqual(self.chosen(*choice)[0], ["registry_test"])

    def test_of_the_chosen_tests_those_that_were_left_out_are_told_with_what_is_missing(self):
        self.listed(("registry_test", "program", "contract room:discovery", "registry_test", "contract_test.cc"),
                    ("ros_test", "program", "server room:drivers ros", "", "outbox_test.cc missing: it needs roscpp"),
                    ("on_storm", "test", "system room:topology java", "", " missing: it needs jni.h"))
        with mock.patch("sys.stdout", new_callable=io.StringIO) as out:
            for words in ([], ["-R", "Outbox"], ["-L", "topology"], ["-L", "discovery"]):
                with mock.patch("sys.argv", ["choose.py", "--left-out", str(self.build), *words]):
                    choose.main()
                out.write("|")
        ros, storm = "ros_test\tit needs roscpp\n", "on_storm\tit needs jni.h\n"
        self.assertEqual(out.getvalue(), f"{ros}{storm}|{ros}|{storm}||")

    def test_cmake_lists_what_is_left_out_with_what_is_missing_and_the_rest_without(self):
        for missing, listed in (('"it needs jni.h"', "on_storm\ttest\tsystem room:topology java release\t\t\tit needs jni.h\n"),
                                ("", "on_storm\ttest\tsystem room:topology java release\tstorm\t\t\n")):
            script = self.build / "it.cmake"
            script.write_text(f"""cmake_minimum_required(VERSION 3.25)
set(PROJECT_SOURCE_DIR /x)
set(CMAKE_CURRENT_SOURCE_DIR /x/tests/topology/storm)
include({TREE}/cmake/IotcloudTests.cmake)
foreach(command add_test set_tests_properties _iotcloud_needed_by_tests)  # a script has no tests
  function(${{command}})
  endfunction()
endforeach()
iotcloud_command_test(NAME on_storm MISSING {missing} LABELS system java NEEDS storm COMMAND it)
get_property(all GLOBAL PROPERTY IOTCLOUD_TESTS)
file(WRITE {self.build}/test_list.tsv "${{all}}")
""")
            subprocess.run(["cmake", "-P", script], check=True)
            self.assertEqual((self.build / "test_list.tsv").read_text(), listed)

    def test_options_with_values_do_not_pass_for_choices(self):
        self.assertEqual(self.chosen("-j", "4", "--repeat", "until-fail:3", "--tests-regex=Outbox", "-L", "unit")[0],
                         ["brokers_test"])
        self.assertEqual(self.chosen("--tests-regex", "Outbox", "--label-regex", "unit", "--schedule-random")[0],
                         ["brokers_test"])


if __name__ == "__main__":
    unittest.main()
