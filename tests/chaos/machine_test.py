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
place = sys.argv[1]
os.mkdir(f"{place}/old")
open(f"{place}/removed", "w").close()

def tried(call):
    try:
        call()
        return 0
    except OSError as error:
        return error.errno

def again(change, back):
    # Undoes what has succeeded, and says what has become of it.
    result = tried(change)
    if result == 0:
        back()
    return result

def make():
    os.close(os.open(f"{place}/made", os.O_CREAT | os.O_WRONLY))

here = os.open(place, os.O_RDONLY)
with open(f"{place}/written", "w+b", buffering=0) as file:
    while input() != "end":
        number = file.fileno()
        print(*map(tried, (
            lambda: file.write(b"1"), lambda: os.writev(number, [b"1"]), lambda: os.pwritev(number, [b"1"], 0),
            lambda: os.pwrite(number, b"1", 0), lambda: os.fsync(number), lambda: os.fdatasync(number),
            lambda: os.ftruncate(number, 1), lambda: os.read(number, 1), lambda: os.readv(number, [bytearray(1)]),
            lambda: os.pread(number, 1, 0))),
            again(make, lambda: os.unlink(f"{place}/made")),
            again(lambda: os.close(os.open("made", os.O_CREAT | os.O_WRONLY, dir_fd=here)), lambda: os.unlink(f"{place}/made")),
            again(lambda: os.mkdir(f"{place}/new"), lambda: os.rmdir(f"{place}/new")),
            again(lambda: os.rename(f"{place}/old", f"{place}/aside"), lambda: os.rename(f"{place}/aside", f"{place}/old")),
            again(lambda: os.unlink(f"{place}/removed"), lambda: open(f"{place}/removed", "w").close()),
            again(lambda: os.unlink("removed", dir_fd=here), lambda: open(f"{place}/removed", "w").close()),
            again(lambda: os.rmdir(f"{place}/old"), lambda: os.mkdir(f"{place}/old")),
            flush=True)
        os.close(os.open(f"{place}/removed", os.O_RDONLY))  # what is there is found on a broken disk, too
"""
CALLS = 17


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

    def test_reading_and_writing_fail_on_a_broken_disk_only_and_as_long_as_it_is_broken(self):
        with tempfile.TemporaryDirectory() as folder:
            disk, beside, file = Path(folder, "disk"), Path(folder, "disk-2"), Path(folder, "machine")
            for place in (disk, beside):
                place.mkdir()
                file.write_text(state(0, 0))
                with subprocess.Popen([sys.executable, "-c", WRITER, place], text=True, stdin=subprocess.PIPE,
                                      stdout=subprocess.PIPE, env={**os.environ, "LD_PRELOAD": str(LIBRARY), "CHAOS_DISK": str(disk),
                                                                   "CHAOS_MACHINE_FILE": str(file)}) as program:
                    for broken in (0, 1, 0):
                        with open(file, "r+", encoding="ascii") as writer:
                            writer.write(state(0, broken))
                        program.stdin.write("\n")
                        program.stdin.flush()
                        expected = errno.EIO if broken and place == disk else 0
                        self.assertEqual(program.stdout.readline().split(), [str(expected)] * CALLS)
                    program.stdin.write("end\n")
                    program.stdin.flush()


if __name__ == "__main__":
    unittest.main()
