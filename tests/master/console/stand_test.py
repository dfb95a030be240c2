#!/usr/bin/python3
"""The console works in a browser: Debian's Chromium on consoles over a fleet that is made up (stand.cc).

usage: stand_test.py CONSOLE_STAND IOTCLOUD [INSTANCES]
"""
import json
import queue
import signal
import subprocess
import sys
import tempfile
import threading
from pathlib import Path

import browser

INSTANCES = 5000


class Stand:
    """A console; its orders are collected."""

    def __init__(self, words):
        self.process = subprocess.Popen([str(word) for word in words], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.url = self.process.stdout.readline().strip()
        self.lines, self.orders, self.ended = queue.Queue(), [], False
        threading.Thread(target=self.read, daemon=True).start()

    def read(self):
        for line in self.process.stdout:
            self.lines.put(line)

    def all_orders(self):
        while not self.lines.empty():
            self.orders.append(json.loads(self.lines.get().removeprefix("ORDER ")))
        return self.orders

    def freeze(self):
        """It closes no connection, and answers nothing: as a machine that is switched off."""
        self.process.send_signal(signal.SIGSTOP)

    def end(self):
        if self.process.poll() is not None and not self.ended:
            sys.exit(f"wrong: a console has ended with {self.process.returncode}")
        self.ended = True
        self.process.kill()
        self.process.wait()


def main():
    program, cli = sys.argv[1:3]
    with tempfile.TemporaryDirectory(prefix="iotcloud-console-") as folder:
        file = Path(folder) / "tokens"
        tokens = {name: subprocess.run([cli, "token", "add", name, "--role", role, "--file", file], check=True, capture_output=True,
                                       text=True).stdout.strip()
                  for name, role in (("anna", "admin"), ("otto", "operator"), ("vera", "viewer"))}
        other = Stand([program, file, INSTANCES])
        first = Stand([program, file, INSTANCES, other.url.rstrip("/")])

        def do(words):
            if words == ["orders"]:
                return first.all_orders()
            first.freeze()
            return None

        try:
            browser.run_script("stand.mjs", {"url": first.url, "other": other.url, "tokens": tokens, "instances": INSTANCES}, do)
        finally:
            first.end()
            other.end()


if __name__ == "__main__":
    main()
