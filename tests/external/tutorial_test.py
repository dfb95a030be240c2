#!/usr/bin/python3
"""Types README.md in the project's folder and docs/tutorial.md into an empty one, as they stand there, and compares what it sees
with what the pages show. It has nothing but an installed prefix (as ~/iotcloud), RabbitMQ and ZooKeeper on their usual ports of a
network of its own.

A code block behind a line that ends with `FILE`: is that file. In a `console` block what follows "$ " is typed, and the lines
below are its output: spaces count as one, "…" stands for any text of a line, and for any lines if it stands alone.

usage: tutorial_test.py BUILD_DIR
"""

import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent / "servers"), str(HERE.parent / "cluster")]

import network_spaces  # noqa: E402
import private_server  # noqa: E402
from private_cluster import PrivateCluster  # noqa: E402

ROOT = HERE.parents[1]
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```", re.DOTALL | re.MULTILINE)
FILE = re.compile(r"^`([\w.]+)`:\s*\Z", re.MULTILINE)
# What no page shows: the shell's words when a job ended, and what an order or a start waits for, which the command line tells
# when it takes long.
NOTICE = re.compile(r"bash: line \d+: +\d+ |\[\d+\][ +-]|iotcloud: waits: |iotcloud-run: it waits for ")
LIMIT_S = 600  # of one command: it may build beside other builds and tests
# What the pages run in the project's folder. Here the programs are installed by CMake and private servers run; the demo and the
# packages have tests of their own.
INSTALLING = {"README.md": ["./dev demo", "./dev test", "./dev install ~/iotcloud", "./dev package"],
              "docs/tutorial.md": ["./dev install ~/iotcloud", "./dev servers up"]}


def steps(page):
    """("file", name, content) and ("command", line, expected output) in the page's order."""
    text = (ROOT / page).read_text(encoding="utf-8")
    for block in BLOCK.finditer(text):
        language, code = block[1], block[2]
        if language == "sh":
            if [line.partition(" #")[0].strip() for line in code.splitlines()] != INSTALLING[page]:
                sys.exit(f"wrong: this test does not know these commands of {page}, only {INSTALLING[page]}:\n{code}")
        elif language == "console":
            for part in re.split(r"^\$ ", code, flags=re.MULTILINE)[1:]:
                command, _, output = part.partition("\n")
                yield "command", command, output
        elif language in ("cpp", "yaml", "cmake"):
            name = FILE.search(text[:block.start()].rstrip())
            if not name:
                sys.exit(f"wrong: no file is named before this block of {page}:\n{code}")
            yield "file", name[1], code


def pattern(expected):
    """The regular expression for what a command prints; `…` as the docstring says."""
    parts = []
    for line in filter(None, (" ".join(line.split()) for line in expected.splitlines())):
        parts.append(r"(?:.*\n)*?" if line == "…" else r"[^\n]*".join(map(re.escape, line.split("…"))) + r"\s*\n")
    return "".join(parts) + r"\Z"


def printed(output):
    lines = [" ".join(line.split()) for line in output.splitlines() if not NOTICE.match(line)]
    return "".join(line + "\n" for line in lines if line)


class Shell:
    """An interactive person's bash: jobs, variables and folder last from one command to the next."""

    def __init__(self, home):
        environment = {**os.environ, "HOME": str(home), "LC_ALL": "C.UTF-8"}
        environment.pop("IOTCLOUD_MASTER", None)
        # All that it starts ends with it, and it ends with this script.
        space = ["unshare", "--pid", "--mount-proc", "--fork", "--kill-child"]
        self.process = subprocess.Popen([*space, "bash", "--norc"], cwd=home, env=environment, stdin=subprocess.PIPE,
                                        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
                                        preexec_fn=private_server.die_with_parent)
        self.process.stdin.write("set -m\n")

    def type(self, command):
        """(exit status, output) of a command."""
        signal.alarm(LIMIT_S)
        self.process.stdin.write(f"{command}\necho \"=== $?\"\n")
        self.process.stdin.flush()
        output = ""
        while not (end := re.search(r"^=== (\d+)\n\Z", output, re.MULTILINE)):
            line = self.process.stdout.readline()
            if not line:
                sys.exit(f"wrong: the shell ended at: {command}\n{output}")
            output += line
        signal.alarm(0)
        return int(end[1]), output[:end.start()]

    def end(self):
        self.process.stdin.close()
        self.process.wait()


def too_long(number, frame):
    del number, frame
    raise TimeoutError(f"a command took more than {LIMIT_S} s")


def walk(page, shell, folder):
    typed = ""
    for kind, name, text in steps(page):
        if kind == "file":
            (folder / name).write_text(text, encoding="utf-8")
            continue
        typed = name
        try:
            status, output = shell.type(name)
        except TimeoutError as error:
            sys.exit(f"wrong: {page}: {error}: {typed}")
        if status or not re.match(pattern(text), printed(output)):
            logs = "".join(f"\n{log.name}:\n{log.read_text()[-2000:]}" for log in sorted(folder.glob("*.log")))
            sys.exit(f"wrong: {page}: $ {name}\nexit status {status}; it printed:\n{output}\nthe page shows:\n{text}{logs}")


def main():
    network_spaces.in_own_network("the tutorial")
    network_spaces.run("ip", "link", "set", "lo", "up")
    tree = Path(sys.argv[1]).resolve()
    home = tree / "tutorial"
    shutil.rmtree(home, ignore_errors=True)
    home.mkdir()
    signal.signal(signal.SIGALRM, too_long)
    network_spaces.run("cmake", "--install", str(tree), "--prefix", str(home / "iotcloud"))
    with PrivateCluster(home / "servers", home / "iotcloud/bin", home) as servers:
        servers.server("rabbitmq", "--port", "5672")  # ./dev servers up
        servers.server("zookeeper", "--port", "2181")
        shell = Shell(home)
        try:
            shell.type(f"cd {ROOT}")
            walk("README.md", shell, ROOT)
            shell.type("cd")
            walk("docs/tutorial.md", shell, home / "weather")
        finally:
            shell.end()


if __name__ == "__main__":
    main()
