#!/usr/bin/python3
"""RabbitMQ and ZooKeeper on their usual ports of loopback, in the background, for a person who tries the programs.

    usual_servers.py --dir DIR [--rabbitmq PORT] [--zookeeper PORT] up|status|down

`up` returns when both answer; they run until `down`, and leave nothing behind but DIR: its data are there again at the next
`up`. Exit status: 0, also when they run already; 1 with the reason. `status`: 0 when they run, 1 when not.
"""
import argparse
import errno
import fcntl
import os
import signal
import socket
import subprocess
import sys
import time

import private_server
from rabbitmq import RabbitMq
from zookeeper import ZooKeeper

STOP_LIMIT_S = 60


class Lock:
    """The file DIR/keeper, which the keeper of the servers locks for as long as it runs, and which has its process id."""

    def __init__(self, folder):
        os.makedirs(folder, exist_ok=True)
        self.file = open(os.path.join(folder, "keeper"), "a+", encoding="ascii")

    def take(self):
        """Whether no other process has it; then it is this one's."""
        try:
            fcntl.flock(self.file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True

    def write(self, process):
        self.file.truncate(0)
        self.file.write(str(process))
        self.file.flush()

    def holder(self):
        """The keeper's process id; 0: it does not run."""
        if self.take():
            fcntl.flock(self.file, fcntl.LOCK_UN)
            return 0
        self.file.seek(0)
        return int(self.file.read() or 0)


def in_use(port):
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", port))
        except OSError as error:
            if error.errno != errno.EADDRINUSE:
                raise
            return True
    return False


def make_servers(given):
    return [RabbitMq(os.path.join(given.dir, "rabbitmq"), given.rabbitmq),
            ZooKeeper(os.path.join(given.dir, "zookeeper"), given.zookeeper)]


def end(number, frame):
    del number, frame
    sys.exit(0)


def keep(given):
    """The process in the background: runs the servers until SIGTERM."""
    lock = Lock(given.dir)
    if not lock.take():
        return  # another `up` was faster
    lock.write(os.getpid())
    signal.signal(signal.SIGTERM, end)
    servers = make_servers(given)
    try:
        for server in servers:
            private_server.say(server.start())
        private_server.say("BOTH")
        while True:
            signal.pause()
    except private_server.PASSING as error:
        private_server.say("ERROR %s" % error)
    finally:
        for server in servers:
            server.stop()


def up(given):
    if Lock(given.dir).holder():
        print("they run already; ./dev servers down ends them")
        return 0
    for name, port in (("RabbitMQ", given.rabbitmq), ("ZooKeeper", given.zookeeper)):
        if in_use(port):
            print("port %d, which is %s's, is in use: if its server runs on this machine already, use that one, else end the "
                  "program that has the port (ss -ltnp 'sport = :%d')" % (port, name, port), file=sys.stderr)
            return 1
    command = [sys.executable, os.path.abspath(__file__), "--dir", given.dir, "--rabbitmq", str(given.rabbitmq), "--zookeeper",
               str(given.zookeeper), "keep"]
    with open(os.path.join(given.dir, "keeper.log"), "ab") as log:
        keeper = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=log, text=True,
                                  start_new_session=True)
    for line in keeper.stdout:
        word, _, rest = line.strip().partition(" ")
        if word == "READY":
            print(rest, flush=True)
        elif word == "BOTH":
            return 0
        else:
            print(rest, file=sys.stderr)
            return 1
    print("their keeper ended; see %s" % os.path.join(given.dir, "keeper.log"), file=sys.stderr)
    return 1


def status(given):
    runs = Lock(given.dir).holder() != 0
    print("they run" if runs else "they do not run; ./dev servers up starts them")
    return 0 if runs else 1


def down(given):
    lock = Lock(given.dir)
    keeper = lock.holder()
    if not keeper:
        print("they do not run")
        return 0
    os.kill(keeper, signal.SIGTERM)
    limit = time.monotonic() + STOP_LIMIT_S
    while lock.holder():
        if time.monotonic() > limit:
            print("they did not end within %d s; their keeper is process %d" % (STOP_LIMIT_S, keeper), file=sys.stderr)
            return 1
        time.sleep(0.05)
    return 0


def main():
    parser = argparse.ArgumentParser(prog="./dev servers", description="RabbitMQ and ZooKeeper on their usual ports of "
                                     "loopback, in the background.")
    parser.add_argument("--dir", required=True, help=argparse.SUPPRESS)
    parser.add_argument("--rabbitmq", type=int, default=5672, metavar="PORT", help="RabbitMQ's port (5672)")
    parser.add_argument("--zookeeper", type=int, default=2181, metavar="PORT", help="ZooKeeper's port (2181)")
    parser.add_argument("what", choices=["up", "status", "down", "keep"], metavar="up|status|down")
    given = parser.parse_args()
    given.dir = os.path.abspath(given.dir)
    sys.exit({"up": up, "status": status, "down": down, "keep": keep}[given.what](given))


if __name__ == "__main__":
    main()
