#!/usr/bin/python3
"""examples/thermostat and examples/fleet_map run by `iotcloud run`, as their READMEs say, until they have done what they are for. Neither
has more than 150 lines.

usage: small_examples_test.py BUILD_DIR EXAMPLES_FOLDER
"""

import re
import signal
import subprocess
import sys
import threading
from pathlib import Path

BUILD, EXAMPLES = Path(sys.argv[1]), Path(sys.argv[2])
MOST_LINES = 150
GIVEN_UP_AFTER_S = 90  # far more than a busy machine needs


class Run:
    """`iotcloud run` of an example, which goes on until it is interrupted."""

    def __init__(self, example, driver, *words):
        command = [BUILD / "bin/iotcloud", "run", EXAMPLES / example / f"{example}.yaml", "--plugin", BUILD / f"plugins/{driver}.so", "--stop-limit", "60", *words]
        self.process = subprocess.Popen([str(word) for word in command], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)

    def until(self, *patterns):
        """Reads what it says until each pattern was in a line, one after the other, and interrupts it."""
        said = ""
        to_come = list(patterns)
        guard = threading.Timer(GIVEN_UP_AFTER_S, self.process.kill)
        guard.start()
        for line in self.process.stdout:
            said += line
            while to_come and re.search(to_come[0], line):
                to_come.pop(0)
            if not to_come:
                break
        self.process.send_signal(signal.SIGINT)
        said += self.process.communicate()[0]
        guard.cancel()
        if to_come or self.process.returncode:
            sys.exit(f"wrong: {' '.join(self.process.args)}: status {self.process.returncode}, not said: {to_come}:\n{said}")


def main():
    for example in ("thermostat", "fleet_map"):
        lines = sum(len(file.read_text().splitlines()) for file in (EXAMPLES / example).iterdir())
        if lines > MOST_LINES:
            sys.exit(f"wrong: examples/{example} has {lines} lines")
    # All at once: they wait more than they compute.
    thermostat = Run("thermostat", "room", "-n", "2", "--property", "start=1{index}")
    fleet = Run("fleet_map", "vehicle", "-n", "3", "--property", "radius={index}00")
    far = Run("fleet_map", "vehicle", "--property", "latitude=48")
    thermostat.until(r"2 room active", r'decide: .*"order":"on"', r"heaters: took [1-9]")
    fleet.until(r"3 vehicle active", r'map: .*"vehicles":3,"map":"\w{6} at 39\.1\d+,-86\.\d+')
    far.until(r"1 vehicle active", r"positions: emitted 0/s")
    print("both do what they are for")


if __name__ == "__main__":
    main()
