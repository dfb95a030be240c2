"""The first process of a space of processes: runs a program, and buries those whose parents have died.

usage: init.py PROGRAM [ARGUMENT]...
"""

import os
import signal
import sys


def main():
    child = os.fork()
    if child == 0:
        os.execv(sys.argv[1], sys.argv[1:])
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN if number == signal.SIGINT else lambda *_: os.kill(child, signal.SIGTERM))
    while True:
        ended, status = os.wait()
        if ended == child:
            os._exit(os.waitstatus_to_exitcode(status) & 0xff)


if __name__ == "__main__":
    main()
