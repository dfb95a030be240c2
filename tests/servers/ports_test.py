#!/usr/bin/python3
"""Two processes that choose ports at the same time never choose the same one."""
import subprocess
import sys
import unittest
from pathlib import Path

FOLDER = Path(__file__).resolve().parent
# A process that tries the same few ports in the same order as the others, and waits.
CHOOSER = """
import random, sys, time
sys.path.insert(0, sys.argv[1])
import private_server
class Ordered:
    def __init__(self, seed): self.next = 9999
    def randrange(self, first, end): self.next += 1; return self.next
private_server.random.Random = Ordered
print(*private_server.free_ports(5), flush=True)
sys.stdin.read()
"""


class PortsTest(unittest.TestCase):
    def test_no_port_is_chosen_twice_while_its_process_lives(self):
        choosers = [subprocess.Popen([sys.executable, "-c", CHOOSER, FOLDER], stdin=subprocess.PIPE,
                                     stdout=subprocess.PIPE, text=True) for _ in range(4)]
        chosen = [chooser.stdout.readline().split() for chooser in choosers]
        for chooser in choosers:
            chooser.communicate()
        ports = [port for line in chosen for port in line]
        self.assertEqual(len(ports), 20)
        self.assertEqual(len(set(ports)), 20, chosen)


if __name__ == "__main__":
    unittest.main()
