#!/usr/bin/python3
"""No server starts for a test whose labels say that it needs none, because ./dev test would not have installed it."""
import os
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

HERE = Path(__file__).resolve().parent


class LabelsTest(unittest.TestCase):
    def greeting(self, script, labels):
        with tempfile.TemporaryDirectory(prefix="iotcloud-labels-") as folder:
            done = subprocess.run([sys.executable, HERE / script, "--dir", folder], stdin=subprocess.DEVNULL, text=True,
                                  capture_output=True, env={**os.environ, "IOTCLOUD_TEST_LABELS": labels}, check=False)
            self.assertEqual((done.returncode, os.listdir(folder)), (1, []))
            return done.stdout

    def test_a_unit_test_or_one_without_servers_gets_none(self):
        self.assertIn("the labels of this test (unit room:config)", self.greeting("zookeeper.py", "unit,room:config"))
        self.assertIn("no such server", self.greeting("rabbitmq.py", "contract,room:gateway,serverless"))

    def test_a_server_of_maven_central_needs_the_label_java(self):
        self.assertIn("the labels of this test (contract room:brokers)", self.greeting("kafka.py", "contract,room:brokers"))
        self.assertIn("no such server", self.greeting("activemq.py", "system,room:system"))


if __name__ == "__main__":
    unittest.main()
