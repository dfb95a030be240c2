#!/usr/bin/python3
"""Prints the first and last lines of each failed test's output, without its cases that passed.

usage: failures.py TESTS_LOG      what ctest wrote with --output-log
"""
import re
import sys

EDGE = 60
NEXT_TEST = re.compile(r"^ *Start +\d+: |^ *\d+/\d+ +Test +#\d+: |^\d+% tests passed")


def failures(lines, name):
    """Yields what to print; `name`: the file, for people who want all of it."""
    kept, began, failed = [], 0, False
    for line in lines:
        if NEXT_TEST.match(line):
            yield from shortened(kept, name)
            kept, began, failed = [], 0, "***" in line and "***Skipped" not in line
        if line.startswith("[ RUN "):
            began = len(kept)
        elif line.startswith("[       OK"):
            del kept[began:]
            continue
        if failed:
            kept.append(line)


def shortened(lines, name):
    if len(lines) <= 2 * EDGE:
        return lines
    return [*lines[:EDGE], f"[{len(lines) - 2 * EDGE} lines are left out: {name}]", *lines[-EDGE:]]


def main():
    if len(sys.argv) != 2:
        sys.exit(__doc__.split("\n\n")[1])
    with open(sys.argv[1], encoding="utf-8", errors="replace") as log:
        for line in failures((line.rstrip("\n") for line in log), sys.argv[1]):
            print(line)


if __name__ == "__main__":
    main()
