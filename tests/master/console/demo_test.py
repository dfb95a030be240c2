#!/usr/bin/python3
"""The demo's robot is on its page while it follows, in a browser: gateway, driver, broker, topology and console in one process, or a
cluster. Leaves a picture in build/console/robot-light.png (docs/console-robot.png is one) and in the dark.

usage: demo_test.py BUILD_DIR [--cluster]     (--cluster: each part a process, with RabbitMQ and ZooKeeper)
"""
import re
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import browser

DEMO = Path(__file__).resolve().parents[3] / "examples/turtlebot_follower/demo.py"
LONGEST_S = 3600  # it is ended before


def main():
    build = Path(sys.argv[1]).resolve()
    with tempfile.TemporaryDirectory(prefix="iotcloud-console-") as out, \
            subprocess.Popen([sys.executable, "-u", DEMO, "--view", *sys.argv[2:], "--seconds", str(LONGEST_S), "--build", build, "--out", out],
                             stdout=subprocess.PIPE, text=True) as demo:
        try:
            for line in demo.stdout:
                print(line, end="", flush=True)
                if found := re.search(r"it is shown at (http\S+)", line):
                    browser.run_script("demo.mjs", {"url": found[1], "name": "robot-cluster" if sys.argv[2:] else "robot"}, lambda _: None)
                    return
            sys.exit("wrong: the demo does not say where its page is")
        finally:
            demo.send_signal(signal.SIGTERM)


if __name__ == "__main__":
    main()
