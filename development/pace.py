#!/usr/bin/python3
"""Prints how many seconds of CPU time a fixed piece of work takes on this machine now.

usage: pace.py

The time that a program waits for a core does not count, so that other programs on the machine change it little: what
it shows is how fast the cores themselves are at the moment. ./dev test looks after each step, and summary.py compares
with the `pace_s` of limits.json.
"""
import random
import time


def work():
    """Takes half a second: text, tables and sorting, as compilers do it, and a few MB of memory."""
    numbers = random.Random(1)
    names = [f"name_{numbers.randrange(10**9)}" for _ in range(420_000)]
    lengths = {}
    for name in names:
        lengths[name] = lengths.get(name[:8], 0) + len(name)
    names.sort()
    return sum(lengths[name] for name in names)


if __name__ == "__main__":
    began = time.process_time()
    work()
    print(f"{time.process_time() - began:.3f}")
