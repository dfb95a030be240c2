"""Whether anything is left of a server: which processes know its folder."""
import os
import time
from pathlib import Path

END_LIMIT_S = 120


def processes_of(folder):
    """The command lines of the processes that name the folder in their arguments or environment, by process id."""
    found = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit() and int(entry.name) != os.getpid():
            try:
                command, environment = (entry / "cmdline").read_bytes(), (entry / "environ").read_bytes()
            except OSError:
                continue  # it has ended, or belongs to another user
            if folder.encode() in command + environment:
                found[int(entry.name)] = command
    return found


def left_behind(folder):
    """Those of them that do not end by themselves. Waits for the kernel, and for Erlang's helpers, which end when their
    pipe closes."""
    limit = time.monotonic() + END_LIMIT_S
    while (left := processes_of(folder)) and time.monotonic() < limit:
        time.sleep(0.02)
    return left
