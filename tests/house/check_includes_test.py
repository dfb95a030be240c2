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

    def test_the_topologys_sdk_sees_messages_only_but_its_parts_see_brokers(self):
        self.assertTrue(self.problems("topology/bolt.h", "#include <iotcloud/brokers/broker.h>"))
        self.assertFalse(self.problems("topology/endpoints/a.cc", "#include <iotcloud/brokers/broker.h>"))

    def test_the_master_uses_only_the_gateways_thrift_client(self):
        self.assertFalse(self.problems("master/a.cc", '#include "iotcloud/gateway/TSensorSiteService.h"'))
        self.assertTrue(self.problems("master/a.cc", "#include <iotcloud/gateway/gateway.h>"))

    def test_the_topologys_scheduling_knows_nothing_of_tasks(self):
        self.assertFalse(self.problems("topology/runtime/tasks/a.h", "#include <iotcloud/topology/runtime/scheduling/lane.h>"))
        self.assertFalse(self.problems("topology/runtime/scheduling/a.h", "#include <iotcloud/config/clock.h>"))
        self.assertFalse(
            self.problems("topology/runtime/scheduling/a.h", "#include <iotcloud/topology/runtime/scheduling/lane.h>"))
        problems = self.problems("topology/runtime/scheduling/a.h", "#include <iotcloud/topology/runtime/tasks/task.h>")
        self.assertEqual(len(problems), 1, problems)
        self.assertIn("topology/runtime/scheduling/ may use no other folder of its room", problems[0])

    def test_folders_beside_each_other_do_not_use_each_other(self):
        with tempfile.TemporaryDirectory() as root:
            for folder in ("runtime", "runtime/tasks", "sending", "receiving"):
                (Path(root) / "topology" / folder).mkdir(parents=True, exist_ok=True)
            (Path(root) / "topology/runtime/a.cc").write_text("#include <iotcloud/topology/runtime/tasks/a.h>\n")
            (Path(root) / "topology/runtime/tasks/a.cc").write_text("#include <iotcloud/topology/runtime/a.h>\n")
            (Path(root) / "topology/sending/a.cc").write_text("#include <iotcloud/topology/receiving/a.h>\n")
            self.assertEqual(check_includes.check(Path(root)), [])
            (Path(root) / "topology/receiving/a.cc").write_text("#include <iotcloud/topology/sending/a.h>\n")
            problems = check_includes.check(Path(root))
            self.assertEqual(len(problems), 2, problems)
            self.assertIn("use each other", problems[0])

    def test_only_the_factory_names_an_implementation(self):
        line = "#include <iotcloud/brokers/rabbitmq/rabbitmq_broker.h>"
        self.assertFalse(self.problems("brokers/make_broker.cc", line))
        self.assertTrue(self.problems("brokers/broker.h", line))
        self.assertTrue(self.problems("gateway/a.cc", line))
        self.assertTrue(self.problems("brokers/client/a.h", line), "what all implementations use knows none of them")
        self.assertTrue(self.problems("gateway/a.cc", "#include <iotcloud/brokers/a_new_one/broker.h>"))
        self.assertFalse(self.problems("topology/endpoints/a.cc", "#include <iotcloud/brokers/spool/spooled_publisher.h>"))
        self.assertFalse(self.problems("topology/local/a.cc", "#include <iotcloud/brokers/embedded/server.h>"))
        self.assertTrue(self.problems("topology/worker/a.cc", "#include <iotcloud/brokers/embedded/server.h>"))

    def test_a_file_named_by_way_of_its_neighbour_is_held_to_the_same_rules(self):
        with tempfile.TemporaryDirectory() as root:
            (Path(root) / "brokers/rabbitmq").mkdir(parents=True)
            (Path(root) / "brokers/rabbitmq/rabbitmq_broker.h").write_text("#pragma once\n")
            (Path(root) / "brokers/a.cc").write_text('#include "rabbitmq/rabbitmq_broker.h"\n')
            problems = check_includes.check(Path(root))
            self.assertEqual(len(problems), 1, problems)
            self.assertIn("may name brokers/rabbitmq/", problems[0])

    def test_a_target_that_uses_a_room_it_may_not_use_is_named_with_file_and_line(self):
        recipes = {
            "brokers": "iotcloud_room(NAME message HEADERS message.h)\niotcloud_room(NAME brokers USES message)\n",
            "gateway": "iotcloud_thrift(NAME gateway_idl FILE a.thrift)\niotcloud_room(NAME gateway USES brokers)\n",
            "master": "# USES gateway\niotcloud_room(\n  NAME master\n  PRIVATE_LIBRARIES iotcloud_gateway_idl)\n",
            "drivers": "iotcloud_room(NAME drivers USES message)\n",
        }
        self.assertEqual(self.problems_of(recipes), [])
        for room, used in (("brokers", "gateway"), ("master", "gateway"), ("master", "brokers"), ("drivers", "brokers")):
            added = {**recipes, room: recipes[room] + f"\niotcloud_room(NAME extra USES {used})\n"}
            problems = self.problems_of(added)
            self.assertEqual(len(problems), 1, problems)
            line = added[room].count("\n")
            self.assertTrue(problems[0].startswith(f"{room}/CMakeLists.txt:{line}: extra uses {used}"), problems)

    def test_what_takes_long_to_compile_is_kept_from_the_demo_and_from_what_asan_alone_would_compile(self):
        recipes = {
            "rpc": "iotcloud_room(NAME page_settings)\niotcloud_room(NAME rpc_http USES page_settings)\n",
            "topology": "iotcloud_room(NAME local USES page_settings)\n",
            "examples": "iotcloud_program(NAME turtlebot-demo USES local)\niotcloud_program(NAME other USES rpc_http)\n",
            "tests": "iotcloud_fuzzer(NAME page USES page_settings)\niotcloud_fuzzer(NAME http THREADED USES rpc_http)\n",
        }
        self.assertEqual(self.problems_of(recipes), [])
        [problem] = self.problems_of({**recipes, "topology": "iotcloud_room(NAME local USES rpc_http)\n"})
        self.assertTrue(problem.startswith("examples/CMakeLists.txt:1: turtlebot-demo uses local -> rpc_http, "), problem)
        [problem] = self.problems_of({**recipes, "tests": recipes["tests"].replace("THREADED ", "")})
        self.assertTrue(problem.startswith("tests/CMakeLists.txt:2: http uses rpc_http, "), problem)
        for labels, is_asan in (("unit SANITIZERS asan", True), ("unit SANITIZERS asan TIMEOUT 9", True), ("unit OPTIMIZED", True),
                                ("contract", False), ("unit SANITIZERS asan tsan", False), ("unit SANITIZERS none", False),
                                ("unit SANITIZERS tsan", False), ("unit LATER SANITIZERS asan", False), ("system", False)):
            test = f"iotcloud_test(NAME page_test SOURCES a.cc USES ${{PARTS}} rpc_http LABELS {labels})\n"
            problems = self.problems_of({**recipes, "tests": recipes["tests"] + test})
            self.assertEqual([problem[:51] for problem in problems],
                             ["tests/CMakeLists.txt:3: page_test uses rpc_http, wh"] if is_asan else [], labels)

    def problems_of(self, recipes):
        with tempfile.TemporaryDirectory() as root:
            for room, recipe in recipes.items():
                (Path(root) / room).mkdir()
                (Path(root) / room / "CMakeLists.txt").write_text(recipe)
            return check_includes.check(Path(root))

    def test_heavy_libraries_are_for_few_sources_and_for_no_header(self):
        self.assertFalse(self.problems("config/log.cc", "#include <spdlog/spdlog.h>"))
        self.assertTrue(self.problems("config/error.cc", "#include <spdlog/spdlog.h>"))
        self.assertFalse(self.problems("gateway/host/host_main.cc", "#include <CLI/CLI.hpp>"))
        self.assertFalse(self.problems("master/cli/verb.cc", "#include <CLI/CLI.hpp>"))
        self.assertTrue(self.problems("master/cli/verb.h", "#include <CLI/CLI.hpp>"))
        self.assertTrue(self.problems("gateway/gateway.cc", "#include <CLI/CLI.hpp>"))
        self.assertTrue(self.problems("rpc/http/page_guard.cc", "#include <boost/beast/http.hpp>"))
        self.assertFalse(self.problems("topology/a.cc", "#include <nlohmann/json.hpp>"))
        self.assertFalse(self.problems("topology/a.h", "#include <nlohmann/json_fwd.hpp>"))
        self.assertFalse(self.problems("discovery/description/json.h", "#include <nlohmann/json.hpp>"))
        problems = self.problems("topology/a.h", "#include <nlohmann/json.hpp>")
        self.assertEqual(len(problems), 1, problems)
        self.assertTrue(problems[0].startswith("topology/a.h:2: nlohmann/json.hpp: nlohmann/json.hpp is heavy"), problems)

    def test_relative_includes_and_missing_guards_are_refused(self):
        self.assertTrue(self.problems("config/a.cc", '#include "../brokers/broker.h"'))
        with tempfile.TemporaryDirectory() as root:
            (Path(root) / "config").mkdir()
            (Path(root) / "config/a.h").write_text("int x;\n")
            self.assertTrue(check_includes.check(Path(root)))


if __name__ == "__main__":
    unittest.main()
