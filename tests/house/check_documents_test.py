#!/usr/bin/python3
"""The checker finds the errors that it looks for, and no others."""

import tempfile
import unittest
from pathlib import Path

import check_documents
import check_includes


class Tree(unittest.TestCase):
    """A small project: docs/wire.md with a section, a header, a source with a metric."""

    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.root = Path(folder.name)
        self.write("there.h", "")
        self.write("rooms/brokers/link.cc", 'counter("iotcloud_things_total");')
        self.write("docs/wire.md", "# Wire\n\n## Message `meta` data, headers\n\n```sh\n# no heading\n```\n")

    def write(self, name, text):
        file = self.root / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
        return file


class Documents(Tree):
    def problems(self, text):
        file = self.write("README.md", f"# First part\n{text}\n")
        return list(check_documents.problems(self.root, [file], {"test", "bench", "bench codec"}))

    def test_a_link_to_nothing_is_named_with_file_and_line(self):
        self.assertEqual(self.problems("see [it](gone.h)"), ["README.md:2: there is no gone.h"])

    def test_links_that_lead_somewhere_are_good(self):
        self.assertEqual(self.problems("[a](there.h), [b](there.h#L3), [c](https://example.org/gone), [d](#first-part), "
                                       "[e](docs/wire.md#message-meta-data-headers)"), [])

    def test_a_link_to_a_section_that_is_not_there_is_named(self):
        self.assertEqual(self.problems("[a](#second-part)"), ["README.md:2: this document has no section #second-part"])
        self.assertEqual(self.problems("[a](docs/wire.md#no-heading)"),
                         ["README.md:2: docs/wire.md has no section #no-heading"])

    def test_a_command_that_dev_does_not_know_is_named(self):
        self.assertEqual(self.problems("`./dev tests`"), ["README.md:2: there is no ./dev tests"])
        self.assertEqual(self.problems("`./dev bench codecs`"), ["README.md:2: there is no ./dev bench codecs"])

    def test_commands_that_dev_knows_are_good(self):
        self.assertEqual(self.problems("`./dev test --long`, `./dev bench`, `./dev bench codec --quick`"), [])

    def test_a_metric_that_nobody_counts_is_named(self):
        self.assertEqual(self.problems("`iotcloud_things_total`"), [])
        self.assertEqual(self.problems("`iotcloud_thing_total`"), ["README.md:2: there is no metric iotcloud_thing_total"])

    def test_a_test_that_is_named_and_not_there_is_told(self):
        self.write("tests/a_test.cc", "TEST_F(Suite, IsThere) {}")
        self.write("tests/CMakeLists.txt", "iotcloud_command_test(NAME a_test_of_a_command LABELS unit)")
        file = self.write("SECURITY.md", "`Suite.IsThere`, `Suite.IsGone`, `a_test_of_a_command`, `a_test_of_a_cat`, `a_key`")
        self.assertEqual(list(check_documents.named_test_problems(self.root, file)),
                         ["SECURITY.md: there is no test Suite.IsGone", "SECURITY.md: there is no test a_test_of_a_cat"])

    def test_tests_may_be_named_by_their_beginning_or_their_suite(self):
        self.write("tests/a_test.cc", "TEST(Suite, IsThere) {}")
        file = self.write("SECURITY.md", "`Suite.Is...`, `Suite.*`, `Suite.Was...`, `Other.*`, `FILE.head`")
        self.assertEqual(list(check_documents.named_test_problems(self.root, file)),
                         ["SECURITY.md: there is no test Suite.Was...", "SECURITY.md: there is no test Other.*"])

    def test_a_cell_of_the_thiefs_table_names_a_test_or_says_that_it_is_only_said(self):
        self.write("tests/a_test.cc", "TEST(Suite, IsThere) {}")
        table = "| stolen | reaches | does not reach |\n|---|---|---|\n"
        for row, problems in (("| a key | doors (`Suite.IsThere`) | windows (said) |", []),
                              ("| a key | doors | windows (`Suite.*`) |", ["SECURITY.md:3: no test of \"doors\", nor that it is only said"]),
                              ("| a key | doors (said) | what is unsaid |",
                               ["SECURITY.md:3: no test of \"what is unsaid\", nor that it is only said"])):
            file = self.write("SECURITY.md", table + row + "\n")
            self.assertEqual(list(check_documents.named_test_problems(self.root, file)), problems)

    def test_a_file_that_is_named_and_not_there_is_told(self):
        file = self.write("rooms/README.md", "`brokers/link.cc`, `rooms/brokers/link.cc`, `<iotcloud/rooms/brokers/link.cc>`\n"
                                             "`brokers/gone.cc`, gone.cc, /usr/include/gone.h")
        self.assertEqual(list(check_documents.named_file_problems(self.root, file)),
                         ["rooms/README.md:2: there is no brokers/gone.cc"])


    def test_code_of_a_document_names_what_it_likes_and_a_diagram_does_not(self):
        file = self.write("README.md", "```cpp\n#include <gone/gone.h>\n```\n```mermaid\na[gone/gone.cc]\n```\n")
        self.assertEqual(list(check_documents.named_file_problems(self.root, file)),
                         ["README.md:5: there is no gone/gone.cc"])

    def test_code_that_is_printed_stands_in_the_file_that_is_linked_before_it(self):
        self.write("project/driver.cc", "int a;\nint b;\n")
        for before, code, problem in (
                ("[driver.cc](project/driver.cc):", "int a;\n", ""),
                ("[driver.cc](project/driver.cc):", "int c;\n",
                 "README.md:3: this code does not stand in project/driver.cc"),
                ("so:", "int a;\n", "README.md:3: no file is linked before this code")):
            file = self.write("README.md", f"{before}\n\n```cpp\n{code}```\n")
            self.assertEqual(list(check_documents.printed_code_problems(self.root, file)), [problem] if problem else [])


class Citations(Tree):
    def problems(self, text):
        file = self.write("rooms/brokers/headers.h", f"#pragma once\n{text}\n")
        return list(check_documents.citation_problems(self.root, [file]))

    def test_documents_and_sections_that_are_there_may_be_cited(self):
        self.write("rooms/brokers/README.md", "")
        self.assertEqual(self.problems("/// The words of docs/wire.md#message-meta-data-headers, docs/wire.md, README.md."), [])

    def test_a_document_that_is_not_there_is_named(self):
        self.assertEqual(self.problems("// see (gone.md 3)"), ["rooms/brokers/headers.h:2: there is no gone.md"])
        self.assertEqual(self.problems("// docs/gone.md#a"), ["rooms/brokers/headers.h:2: there is no docs/gone.md"])

    def test_a_section_that_is_not_there_is_named(self):
        self.assertEqual(self.problems("// docs/wire.md#topics."),
                         ["rooms/brokers/headers.h:2: docs/wire.md has no section #topics"])

    def test_a_path_that_begins_at_the_root_of_a_machine_is_no_citation(self):
        self.assertEqual(self.problems("// /usr/share/doc/gone.md"), [])


class Walks(Tree):
    WALK = ("# Walks\n## One\n| 1 | rooms/brokers | `rooms/brokers/link.cc` | sends |\n| 2 | Server | | keeps |\n"
            "| 3 | rooms/brokers | `rooms/brokers/link.cc` | reads |\n| 4 | rooms/brokers | `rooms/brokers/link.cc` | hands on |\n"
            "| 5 | docs | | is told |\n| room | times |\n|---|---|\n| rooms/brokers | 2 |\n| docs | 1 |\n")

    def problems(self, text):
        return list(check_documents.walk_problems(self.root, self.write("docs/walks.md", text)))

    def test_rooms_are_counted_when_they_are_entered_and_between_servers(self):
        self.assertEqual(self.problems(self.WALK), [])

    def test_a_wrong_count_is_named(self):
        self.assertEqual(self.problems(self.WALK.replace("| 2 |\n| docs", "| 3 |\n| docs")),
                         ["docs/walks.md: One: rooms/brokers is entered 2 times, not 3"])

    def test_a_room_that_is_not_counted_is_named(self):
        self.assertEqual(self.problems(self.WALK.replace("| docs | 1 |\n", "")),
                         ["docs/walks.md: One: docs is entered 1 times, not 0"])

    def test_a_file_of_another_room_is_named(self):
        self.assertEqual(self.problems(self.WALK.replace("| 5 | docs | |", "| 5 | docs | `rooms/brokers/link.cc` |")),
                         ["docs/walks.md: One: rooms/brokers/link.cc is not in docs"])


class Rooms(Tree):
    def problems(self, change=lambda row: row):
        table = "".join(change(f"| [{room}](../{room}) | is | {'everything' if uses is None else ', '.join(uses)} |\n")
                        for room, uses in {**check_includes.ROOMS, **check_includes.PARTS}.items())
        return list(check_documents.room_problems(self.root, self.write("docs/design.md", table)))

    def test_the_table_that_says_what_is_allowed_is_good(self):
        self.assertEqual(self.problems(), [])

    def test_a_room_that_may_use_another_one_is_named(self):
        self.assertEqual(self.problems(lambda row: row.replace(", security |", " |") if "[rpc]" in row else row),
                         ["docs/design.md: rpc may use config, security"])

    def test_a_room_that_is_missing_is_named(self):
        self.assertEqual(self.problems(lambda row: "" if "[rpc]" in row else row), ["docs/design.md: the room rpc is missing"])


if __name__ == "__main__":
    unittest.main()
