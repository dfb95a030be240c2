#!/usr/bin/python3
"""The checker finds what it is there to find, and nothing else."""

import tempfile
import unittest
from pathlib import Path

import check_includes


class CheckIncludes(unittest.TestCase):
    def problems(self, file, line):
        with tempfile.TemporaryDirectory() as root:
            path = Path(root) / file
            path.parent.mkdir(parents=True)
            path.write_text(f"#pragma once\n{line}\n")
            return check_includes.check(Path(root))

    def test_an_upward_include_is_named_with_file_and_line(self):
        problems = self.problems("brokers/a.h", "#include <iotcloud/topology/bolt.h>")
        self.assertEqual(len(problems), 1)
        self.assertTrue(problems[0].startswith("brokers/a.h:2: iotcloud/topology/bolt.h"), problems[0])

    def test_gateway_and_topology_do_not_know_each_other(self):
        self.assertTrue(self.problems("gateway/a.cc", "#include <iotcloud/topology/bolt.h>"))
        self.assertTrue(self.problems("topology/endpoints/a.cc", "#include <iotcloud/gateway/gateway.h>"))

    def test_the_local_part_may_link_all_rooms(self):
        self.assertFalse(self.problems("topology/local/a.cc", "#include <iotcloud/gateway/gateway.h>"))

    def test_drivers_see_messages_and_nothing_else_of_brokers(self):
        self.assertFalse(self.problems("drivers/a.h", "#include <iotcloud/brokers/message.h>"))
        self.assertTrue(self.problems("drivers/a.h", "#include <iotcloud/brokers/broker.h>"))

    def test_the_master_uses_only_the_gateways_thrift_client(self):
        self.assertFalse(self.problems("master/a.cc", '#include "iotcloud/gateway/TSensorSiteService.h"'))
        self.assertTrue(self.problems("master/a.cc", "#include <iotcloud/gateway/gateway.h>"))

    def test_only_the_factory_names_an_implementation(self):
        line = "#include <iotcloud/brokers/rabbitmq/rabbitmq_broker.h>"
        self.assertFalse(self.problems("brokers/make_broker.cc", line))
        self.assertTrue(self.problems("brokers/broker.h", line))
        self.assertTrue(self.problems("gateway/a.cc", line))

    def test_relative_includes_and_missing_guards_are_refused(self):
        self.assertTrue(self.problems("config/a.cc", '#include "../brokers/broker.h"'))
        with tempfile.TemporaryDirectory() as root:
            (Path(root) / "config").mkdir()
            (Path(root) / "config/a.h").write_text("int x;\n")
            self.assertTrue(check_includes.check(Path(root)))


if __name__ == "__main__":
    unittest.main()
