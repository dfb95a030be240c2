"""Servers that run in the background for a person, until they are told to end: a process of their own keeps them.

A script makes a `Background` and calls run(): its last word is up, status or down. `up` returns when all servers answer; they
run until `down`, and leave nothing behind but their folder: its data are there again at the next `up`. Exit status: 0, also when
they run already; 1 with the reason. `status`: 0 when they run, 1 when not.
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


def end(number, frame):
    del number, frame
    sys.exit(0)


class Background:
    def __init__(self, command, description, ports, make):
        """`command`: what a person calls ("./dev servers"). `ports`: by name of a server, its usual port. `make`: gets the
        folder and the ports by name, and returns the servers."""
        self.command, self.ports, self.make = command, ports, make
        parser = argparse.ArgumentParser(prog=command, description=description)
        parser.add_argument("--dir", required=True, help=argparse.SUPPRESS)
        for name, port in ports.items():
            parser.add_argument("--" + name.lower(), dest=name, type=int, default=port, metavar="PORT",
                                help="%s's port (%d)" % (name, port))
        parser.add_argument("what", choices=["up", "status", "down", "keep"], metavar="up|status|down")
        self.given = parser.parse_args()
        self.folder = os.path.abspath(self.given.dir)

    def chosen_ports(self):
        return {name: getattr(self.given, name) for name in self.ports}

    def run(self):
        sys.exit({"up": self.up, "status": self.status, "down": self.down, "keep": self.keep}[self.given.what]())

    def keep(self):
        """The process in the background: runs the servers until SIGTERM."""
        lock = Lock(self.folder)
        if not lock.take():
            return  # another `up` was faster
        lock.write(os.getpid())
        signal.signal(signal.SIGTERM, end)
        servers = []
        try:
            servers = self.make(self.folder, self.chosen_ports())
            for server in servers:
                private_server.say(server.start())
            private_server.say("ALL")
            while True:
                signal.pause()
        except (private_server.Unavailable, *private_server.PASSING) as error:
            private_server.say("ERROR %s" % error)
        finally:
            for server in servers:
                server.stop()

    def up(self):
        if Lock(self.folder).holder():
            print("they run already; %s down ends them" % self.command)
            return 0
        ports = self.chosen_ports()
        for name, port in ports.items():
            if in_use(port):
                print("port %d, which is %s's, is in use: if its server runs on this machine already, use that one, else end "
                      "the program that has the port (ss -ltnp 'sport = :%d')" % (port, name, port), file=sys.stderr)
                return 1
        words = [word for name, port in ports.items() for word in ("--" + name.lower(), str(port))]
        log_name = os.path.join(self.folder, "keeper.log")
        with open(log_name, "ab") as log:
            keeper = subprocess.Popen([sys.executable, os.path.abspath(sys.argv[0]), "--dir", self.folder, *words, "keep"],
                                      stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=log, text=True,
                                      start_new_session=True)
        for line in keeper.stdout:
            word, _, rest = line.strip().partition(" ")
            if word == "READY":
                print(rest, flush=True)
            elif word == "ALL":
                return 0
            else:
                print(rest, file=sys.stderr)
                return 1
        print("their keeper ended; see %s" % log_name, file=sys.stderr)
        return 1

    def status(self):
        runs = Lock(self.folder).holder() != 0
        print("they run" if runs else "they do not run; %s up starts them" % self.command)
        return 0 if runs else 1

    def down(self):
        lock = Lock(self.folder)
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
