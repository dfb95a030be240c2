#!/usr/bin/python3
"""`iotcloud run`: a topology and its drivers in one process, without any server.

usage: local_run_test.py BUILD_DIR CONFIG_FOLDER
"""
import re
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

BUILD, CONFIG = Path(sys.argv[1]), Path(sys.argv[2])

MEAN = """\
zk.servers: ["127.0.0.1:2181"]
topology.name: "mean"
topology.library: "libtopology_test_mean.so"
spouts:
  in: {broker: "rabbitmq", driver: "loadgen", channel: "data", fields: ["data", "driverID", "time"]}
bolts:
  mean: {class: "mean.Size", conf: {WINDOW: 1s}, inputs: [{from: in, grouping: fields, fields: [driverID]}]}
"""


class Run:
    """A run whose lines, errors too, are read as they come."""

    def __init__(self, *words):
        self.began = time.monotonic()
        self.said = ""
        self.process = subprocess.Popen([BUILD / "bin/iotcloud", "run", *words, "--plugin", BUILD / "plugins/loadgen.so"],
                                        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)

    def wait_for(self, pattern):
        """Returns the line, and the seconds since the start."""
        for line in self.process.stdout:
            self.said += line
            if re.search(pattern, line):
                return line.strip(), time.monotonic() - self.began
        sys.exit(f"it ended without {pattern!r}, status {self.process.wait()}:\n{self.said}")

    def end(self, status=0):
        self.process.send_signal(signal.SIGINT)
        rest, _ = self.process.communicate(timeout=60)
        if self.process.returncode != status:
            sys.exit(f"status {self.process.returncode}:\n{self.said}{rest}")


def the_files_of_a_cluster_run_as_they_stand():
    # The file of the README's echo topology names ZooKeeper and RabbitMQ, which are not there.
    echo = Run(CONFIG / "topology.yaml", "-n", "2", "--property", "rate=50")
    echo.wait_for(r"data_receive: emitted [1-9]\d*/s")
    if "2 loadgen active" not in echo.said:
        sys.exit("the instances are not shown:\n" + echo.said)
    echo.end()


def the_first_average_is_there_soon_and_changes_are_taken_up():
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "mean.yaml"
        file.write_text(MEAN.replace("WINDOW", "window.length"))
        mean = Run(file, "--property", "rate=50")
        average = r"mean: took [1-9]\d*/s, emitted [1-9]\d*/s.*mean"
        line, seconds = mean.wait_for(average)
        print(f"from the start to the first average of a window of 1 s: {seconds:.2f} s: {line}")
        file.write_text(MEAN.replace("WINDOW", "window.lenght"))
        mean.wait_for("mean.yaml changed: all starts anew")
        mean.wait_for("window.lenght")
        mean.wait_for("waiting for a file to change")
        file.write_text(MEAN.replace("WINDOW: 1s", "window.length: 500ms"))
        mean.wait_for(average)
        mean.end()


def a_property_that_the_driver_does_not_have_ends_the_run():
    wrong = Run(CONFIG / "topology.yaml", "--property", "rat=50", "--seconds", "1")
    wrong.wait_for(r"iotcloud-run: .*loadgen.so: .*rat")
    if wrong.process.wait(timeout=60) != 2:
        sys.exit(f"status {wrong.process.returncode}:\n{wrong.said}")


def main():
    the_files_of_a_cluster_run_as_they_stand()
    the_first_average_is_there_soon_and_changes_are_taken_up()
    a_property_that_the_driver_does_not_have_ends_the_run()


if __name__ == "__main__":
    main()
