#!/usr/bin/python3
"""A program whose time of the day goes wrong, while its other clocks and waits do not, and whose disk breaks.

usage: machine_test.py LIBRARY
"""
import errno
import os
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

LIBRARY = Path(sys.argv.pop())
PROGRAM = """
import threading, time
for _ in range(2):
    input()
    print(time.time(), flush=True)
    before = time.monotonic()
    time.sleep(0.01)
    threading.Event().wait(0.01)
    threading.Lock().acquire(timeout=0.01)
    print(time.monotonic() - before, flush=True)
"""


WRITER = """
import os, sys
with open(sys.argv[1], "wb", buffering=0) as file:
    while input() != "end":
        done = []
        for write in (lambda: file.write(b"1"), lambda: os.writev(file.fileno(), [b"1"]), lambda: os.pwritev(file.fileno(), [b"1"], 0),
                      lambda: os.pwrite(file.fileno(), b"1", 0), lambda: os.fsync(file.fileno()),
                      lambda: os.fdatasync(file.fileno()), lambda: os.ftruncate(file.fileno(), 1)):
            try:
                write()
                done.append(0)
            except OSError as error:
                done.append(error.errno)
        print(*done, flush=True)
"""


def state(ahead, broken):
    return f"{ahead:<15}\n{broken:<15}\n"


class MachineTest(unittest.TestCase):
    def test_a_clock_is_as_far_ahead_as_its_file_says(self):
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder, "machine")
            file.write_text(state(0, 0))
            with subprocess.Popen([sys.executable, "-c", PROGRAM], text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                                  env={**os.environ, "LD_PRELOAD": str(LIBRARY), "CHAOS_MACHINE_FILE": str(file)}) as program:
                clock = subprocess.run(["date", "+%s"], capture_output=True, text=True, check=True).stdout
                for ahead in (3600, -3600):
                    with open(file, "r+", encoding="ascii") as writer:
                        writer.write(state(ahead, 0))
                    program.stdin.write("\n")
                    program.stdin.flush()
                    self.assertLess(abs(float(program.stdout.readline()) - float(clock) - ahead), 600)
                    waited = float(program.stdout.readline())
                    self.assertGreater(waited, 0.01)
                    self.assertLess(waited, 600)

    def test_writing_fails_on_a_broken_disk_only_and_as_long_as_it_is_broken(self):
        with tempfile.TemporaryDirectory() as folder:
            disk, file = Path(folder, "disk"), Path(folder, "machine")
            disk.mkdir()
            for place in (disk, Path(folder)):
                file.write_text(state(0, 0))
                with subprocess.Popen([sys.executable, "-c", WRITER, place / "written"], text=True, stdin=subprocess.PIPE,
                                      stdout=subprocess.PIPE, env={**os.environ, "LD_PRELOAD": str(LIBRARY), "CHAOS_DISK": str(disk),
                                                                   "CHAOS_MACHINE_FILE": str(file)}) as program:
                    for broken in (0, 1, 0):
                        with open(file, "r+", encoding="ascii") as writer:
                            writer.write(state(0, broken))
                        program.stdin.write("\n")
                        program.stdin.flush()
                        expected = errno.EIO if broken and place == disk else 0
                        self.assertEqual(program.stdout.readline().split(), [str(expected)] * 7)
                    program.stdin.write("end\n")
                    program.stdin.flush()


if __name__ == "__main__":
    unittest.main()
