#!/usr/bin/python3
"""A private ZooKeeper for tests and demos, on loopback only, that leaves nothing behind.

    zookeeper.py --dir DIR [--port N]

Runs one server from Debian's jars with its data and log below DIR, on a free port. When it answers requests it prints
one line on stdout:

    READY zookeeper://127.0.0.1:PORT

Then it obeys one command for each line of stdin and answers with one line on stdout:

    kill    SIGKILL to the server                  KILLED
    start   starts it again, same port and data    READY zookeeper://...
    pause   SIGSTOP to the server: it hangs        PAUSED
    resume  SIGCONT                                RESUMED
    stop    ends everything                        STOPPED

The end of stdin means `stop`, so the server ends with whoever started it. A command that fails answers `ERROR text`.
Data of an earlier run in DIR are kept. Session time-outs from 0.4 s on are accepted.
"""
import argparse
import ctypes
import os
import random
import signal
import socket
import subprocess
import sys
import time

JARS = "/usr/share/java"
CLASS_PATH = ["zookeeper", "zookeeper-jute", "slf4j-api", "slf4j-simple", "metrics-core", "snappy-java",
              "netty-handler", "netty-common", "netty-transport", "netty-buffer", "netty-codec", "netty-resolver",
              "netty-transport-native-epoll", "netty-transport-native-unix-common", "commons-cli"]
START_LIMIT_S = 90
PR_SET_PDEATHSIG = 1
LIBC = ctypes.CDLL("libc.so.6", use_errno=True)


def become_child():
    """In the child before exec: an own process group, and death with the parent."""
    os.setpgid(0, 0)
    LIBC.prctl(PR_SET_PDEATHSIG, signal.SIGKILL)


def free_port():
    """A port that is free now, below the range from which the kernel takes ports for outgoing connections: while the
    server is down between `kill` and `start` no client's socket can take its port."""
    with open("/proc/sys/net/ipv4/ip_local_port_range", encoding="ascii") as file:
        first_ephemeral = int(file.read().split()[0])
    choose = random.Random(os.getpid() ^ time.time_ns())
    while True:
        port = choose.randrange(10000, max(10500, first_ephemeral))
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                continue
        return port


class ZooKeeper:
    def __init__(self, folder, port):
        self.folder = os.path.abspath(folder)
        os.makedirs(os.path.join(self.folder, "data"), exist_ok=True)
        self.port = port or free_port()
        self.process = None
        self.config = os.path.join(self.folder, "zoo.cfg")
        with open(self.config, "w", encoding="ascii") as file:
            # Sessions expire in steps of tickTime.
            file.write("tickTime=200\ninitLimit=50\nsyncLimit=25\nminSessionTimeout=400\nmaxSessionTimeout=60000\n")
            file.write("dataDir=%s\n" % os.path.join(self.folder, "data"))
            file.write("clientPortAddress=127.0.0.1\nclientPort=%d\nmaxClientCnxns=0\n" % self.port)
            file.write("admin.enableServer=false\n4lw.commands.whitelist=srvr\n")

    def command(self):
        jars = [os.path.join(JARS, name + ".jar") for name in CLASS_PATH]
        if not os.path.exists(jars[0]):
            raise RuntimeError("%s is missing; install Debian's package zookeeper" % jars[0])
        return ["java", "-Xms24m", "-Xmx128m", "-XX:+UseSerialGC", "-XX:TieredStopAtLevel=1", "-Xshare:auto",
                "-XX:-UsePerfData", "-Dzookeeper.jmx.log4j.disable=true", "-Dzookeeper.forceSync=no",
                "-Dzookeeper.preAllocSize=1024", "-Dorg.slf4j.simpleLogger.defaultLogLevel=info",
                "-Dorg.slf4j.simpleLogger.showDateTime=true",
                "-Dorg.slf4j.simpleLogger.dateTimeFormat=yyyy-MM-dd HH:mm:ss.SSS",
                "-cp", ":".join(jars), "org.apache.zookeeper.server.quorum.QuorumPeerMain", self.config]

    def start(self):
        if self.process and self.process.poll() is None:
            raise RuntimeError("the server runs already")
        log_name = os.path.join(self.folder, "zookeeper.log")
        env = {**os.environ, "JMXDISABLE": "true"}
        for name in ("JAVA_TOOL_OPTIONS", "_JAVA_OPTIONS", "CLASSPATH"):
            env.pop(name, None)
        with open(log_name, "ab") as log:
            self.process = subprocess.Popen(self.command(), cwd=self.folder, env=env, stdin=subprocess.DEVNULL,
                                            stdout=log, stderr=log, preexec_fn=become_child)
        limit = time.monotonic() + START_LIMIT_S
        while not self.serves():
            if self.process.poll() is not None:
                raise RuntimeError("ZooKeeper ended with status %d; see %s" % (self.process.returncode, log_name))
            if time.monotonic() > limit:
                raise RuntimeError("ZooKeeper was not ready within %d s; see %s" % (START_LIMIT_S, log_name))
            time.sleep(0.02)
        return "READY zookeeper://127.0.0.1:%d" % self.port

    def serves(self):
        """`srvr` tells the mode only once requests are served; `ruok` says imok long before."""
        try:
            with socket.create_connection(("127.0.0.1", self.port), timeout=1) as probe:
                probe.settimeout(0.3)  # asked too early it may never answer
                probe.sendall(b"srvr")
                answer = b""
                while True:
                    chunk = probe.recv(4096)
                    if not chunk:
                        return b"Mode:" in answer
                    answer += chunk
        except OSError:
            return False

    def signal(self, number):
        if not self.process or self.process.poll() is not None:
            raise RuntimeError("the server does not run")
        os.killpg(self.process.pid, number)

    def kill(self):
        self.signal(signal.SIGKILL)
        self.process.wait()
        return "KILLED"

    def pause(self):
        self.signal(signal.SIGSTOP)
        return "PAUSED"

    def resume(self):
        self.signal(signal.SIGCONT)
        return "RESUMED"

    def stop(self):
        """ZooKeeper writes its log ahead: nothing is lost by ending it hard."""
        if self.process and self.process.poll() is None:
            self.kill()
        return "STOPPED"


def say(line):
    try:
        print(line, flush=True)
    except OSError:
        pass  # whoever listened is gone; the end of stdin follows


def serve(server):
    commands = {"kill": server.kill, "start": server.start, "pause": server.pause, "resume": server.resume}
    say(server.start())
    for line in sys.stdin:
        command = line.strip()
        if command == "stop":
            return
        if command not in commands:
            say("ERROR no such command: %s; there are: %s stop" % (command, " ".join(commands)))
            continue
        try:
            say(commands[command]())
        except (RuntimeError, OSError) as error:
            say("ERROR %s" % error)


def main():
    parser = argparse.ArgumentParser(description="A private ZooKeeper on loopback; commands come on stdin.")
    parser.add_argument("--dir", required=True, help="folder for data and log")
    parser.add_argument("--port", type=int, default=0, help="client port; default: a free one")
    arguments = parser.parse_args()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the starter too, which closes stdin
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    server = ZooKeeper(arguments.dir, arguments.port)
    status = 0
    try:
        serve(server)
    except (RuntimeError, OSError) as error:
        say("ERROR %s" % error)
        status = 1
    finally:
        answer = server.stop()
    say(answer)
    return status


if __name__ == "__main__":
    sys.exit(main())
