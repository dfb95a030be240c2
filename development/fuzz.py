#!/usr/bin/python3
"""Fuzzes all targets, one on each processor: what `./dev fuzz` does when they are built.

usage: fuzz.py SECONDS      for each target

A target begins with its files in the tree and the inputs of earlier runs. A crash leaves its input in
build/fuzz/crashes. build/fuzz/tests.xml has each target as a test, for summary.py. The exit status is 1 when a target found something.
"""
import concurrent.futures
import os
import re
import subprocess
import sys
import time
import xml.etree.ElementTree as xml
from pathlib import Path

from progress import Teller

ROOT = Path(__file__).resolve().parent.parent
KEPT = ROOT / "tests/fuzz/corpus"
EXECUTIONS = re.compile(r"stat::number_of_executed_units:\s*(\d+)")


def fuzz(name, seconds, folder):
    """Returns whether the target found nothing, what to tell of it, and how many seconds it took."""
    found_before, log = folder / "corpus" / name, folder / f"{name}.log"
    found_before.mkdir(parents=True, exist_ok=True)
    command = [folder / f"bin/{name}_fuzzer", f"-max_total_time={seconds}", "-max_len=65536", "-timeout=10",
               "-rss_limit_mb=2048", "-verbosity=0", "-print_final_stats=1",
               f"-artifact_prefix={folder / 'crashes' / name}-", found_before, KEPT / name]
    began = time.monotonic()
    with open(log, "w", encoding="utf-8") as out:
        status = subprocess.run(command, stdin=subprocess.DEVNULL, stdout=out, stderr=out, check=False,
                                env={**os.environ, "UBSAN_OPTIONS": "print_stacktrace=1:halt_on_error=1"}).returncode
    took = time.monotonic() - began
    said = log.read_text(errors="replace")
    if status == 0:
        executions = EXECUTIONS.search(said)
        return True, f"{executions[1] if executions else 'no'} executions in {seconds} s, nothing found", took
    return False, "\n".join([*said.splitlines()[-40:], f"it found something; the input is in {folder / 'crashes'}: run "
                             f"{command[0]} FILE"]), took


class Targets:
    """How far the fuzzing is, for Teller."""

    def __init__(self, count, seconds):
        self.left = self.count = count
        self.seconds = seconds

    def share(self):
        return (self.count - self.left) / self.count

    def text(self):
        return f"{self.left} of {self.count} targets left, {self.seconds} s each", ""


def run(names, seconds, folder, out):
    """Returns how many targets found something."""
    (folder / "crashes").mkdir(parents=True, exist_ok=True)
    targets = Targets(len(names), seconds)
    teller = Teller("fuzzing", targets, out)
    found, results = 0, xml.Element("testsuite", name="fuzzing")
    with concurrent.futures.ThreadPoolExecutor(os.cpu_count()) as pool:
        running = {pool.submit(fuzz, name, seconds, folder): name for name in names}
        while running:
            done, _ = concurrent.futures.wait(running, timeout=1, return_when=concurrent.futures.FIRST_COMPLETED)
            for result in done:
                name = running.pop(result)
                clean, text, took = result.result()
                teller.say(f"fuzz {name}: {text}")
                xml.SubElement(results, "testcase", name=name, time=f"{took:.2f}", status="run" if clean else "fail")
                targets.left -= 1
                found += not clean
            teller.tick()
    teller.end()
    xml.ElementTree(results).write(folder / "tests.xml")
    return found


def main():
    if len(sys.argv) != 2 or not sys.argv[1].isdigit():
        sys.exit(__doc__.split("\n\n")[1])
    found = run(sorted(folder.name for folder in KEPT.iterdir()), int(sys.argv[1]), ROOT / "build/fuzz", sys.stdout)
    if found:
        print(f"{found} targets found something")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
