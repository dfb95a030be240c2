"""What the scripts of this folder share: a server below a private folder, on loopback only, that obeys commands.

A script makes a subclass of `Server` and hands it to `run`. The first line on stdout is what `start` answers ("READY
url"), "SKIP text" when the server itself cannot be had (its jars cannot be fetched), or "ERROR text". Then each line of
stdin is a command and has one line of answer. The end of stdin means `stop`: no server outlives the process that
started the script.
"""
import argparse
import ctypes
import inspect
import os
import random
import signal
import socket
import subprocess
import sys
import time

START_LIMIT_S = 240
PR_SET_PDEATHSIG = 1
LIBC = ctypes.CDLL("libc.so.6", use_errno=True)
PASSING = (RuntimeError, OSError, subprocess.SubprocessError)  # answered as "ERROR text"


# Options of every JVM. The log (slf4j-simple) goes to stderr.
JVM_OPTIONS = ["-Xshare:auto", "-XX:-UsePerfData",
               "-Dorg.slf4j.simpleLogger.defaultLogLevel=info", "-Dorg.slf4j.simpleLogger.showDateTime=true",
               "-Dorg.slf4j.simpleLogger.dateTimeFormat=yyyy-MM-dd HH:mm:ss.SSS"]


# JVM options by use: a server for tests starts quickly; one for benchmarks has the optimizing compiler, more memory,
# and the garbage collector that Kafka's own start script chooses.
SMALL_JVM = ["-XX:+UseSerialGC", "-XX:TieredStopAtLevel=1"]
QUICK_START = ["-Xms64m", "-Xmx512m", *SMALL_JVM]
THROUGHPUT = ["-Xms1g", "-Xmx1g", "-XX:+UseG1GC", "-XX:MaxGCPauseMillis=20"]


class Unavailable(Exception):
    """The server cannot run on this machine now, for a reason outside of this project."""


def die_with_parent(how=signal.SIGTERM):
    """Called in a child before exec: the kernel sends it the signal `how` when the thread that started it ends, for
    whatever reason."""
    LIBC.prctl(PR_SET_PDEATHSIG, how)


def become_child():
    """Called in a child before exec: gives it a process group of its own, and lets it die with its parent."""
    os.setpgid(0, 0)
    die_with_parent(signal.SIGKILL)


def wait_until_frozen(process):
    """Waits until the child has stopped: on another CPU its threads run for a moment after SIGSTOP."""
    os.waitid(os.P_PID, process.pid, os.WSTOPPED | os.WEXITED | os.WNOWAIT)


def freeze(process):
    """Stops all threads of this child until it is sent SIGCONT. Raises ChildProcessError when it has ended."""
    process.send_signal(signal.SIGSTOP)
    wait_until_frozen(process)


reservations = []  # abstract sockets, which go with this process


def reserve(port):
    """Whether no other process of the tests has chosen this port; then it is this one's until the process ends. Servers
    take seconds until they listen at the ports that were chosen for them."""
    mark = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        mark.bind("\0iotcloud-port-%d" % port)
    except OSError:
        mark.close()
        return False
    reservations.append(mark)
    return True


def free_ports(count):
    """Ports that are free now and reserved for this process, below the range from which the kernel takes ports for
    outgoing connections: while the server is down between `kill` and `start` no client's socket can take its port."""
    with open("/proc/sys/net/ipv4/ip_local_port_range", encoding="ascii") as file:
        first_ephemeral = int(file.read().split()[0])
    found = []
    choose = random.Random(os.getpid() ^ time.time_ns())
    while len(found) < count:
        port = choose.randrange(10000, max(10500, first_ephemeral))
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                continue
        if reserve(port):
            found.append(port)
    return found


def java_environment():
    """The environment without the variables that change a JVM."""
    return {key: value for key, value in os.environ.items()
            if key not in ("JAVA_TOOL_OPTIONS", "_JAVA_OPTIONS", "CLASSPATH")}


class Server:
    """One process in its own group. A subclass gives `name`, `command()` and `answers()`, and `url()`."""

    name = "the server"
    grace_s = 0  # seconds that `stop` gives it to write its data; 0: it has a write-ahead log, so it is killed

    def __init__(self, folder):
        self.folder = os.path.abspath(folder)
        os.makedirs(self.folder, exist_ok=True)
        self.process = None
        self.certificates = None  # None: no TLS; else the authority whose client certificates it requires

    def path(self, *parts):
        return os.path.join(self.folder, *parts)

    def write(self, name, lines):
        """Writes a file below the folder, one line for each of `lines`; returns its path."""
        with open(self.path(name), "w", encoding="utf-8") as file:
            file.writelines(line + "\n" for line in lines)
        return self.path(name)

    def command(self):
        raise NotImplementedError

    def environment(self):
        return dict(os.environ)

    def answers(self):
        """True once the server answers requests; may raise OSError before that."""
        raise NotImplementedError

    def url(self):
        raise NotImplementedError

    def connect(self, port):
        """Connects to the server as a client does."""
        plain = socket.create_connection(("127.0.0.1", port), timeout=5)
        if not self.certificates:
            return plain
        try:
            return self.certificates.client_context().wrap_socket(plain, server_hostname="localhost")
        except OSError:
            plain.close()
            raise

    def log(self):
        return self.path("server.log")

    def spawn(self, command, environment, log):
        with open(log, "ab") as out:
            return subprocess.Popen(command, cwd=self.folder, env=environment, stdin=subprocess.DEVNULL, stdout=out,
                                    stderr=out, preexec_fn=become_child)

    def runs(self):
        return self.process is not None and self.process.poll() is None

    def start(self):
        self.launch()
        self.wait_until_ready()
        return "READY " + self.url()

    def launch(self):
        if self.runs():
            raise RuntimeError("%s runs already" % self.name)
        self.process = self.spawn(self.command(), self.environment(), self.log())

    def wait_until_ready(self):
        limit = time.monotonic() + START_LIMIT_S
        while True:
            try:
                if self.answers():
                    return
            except OSError:
                pass
            if not self.runs():
                raise RuntimeError("%s ended with status %d; see %s" % (self.name, self.process.returncode,
                                                                        self.log()))
            if time.monotonic() > limit:
                raise RuntimeError("%s was not ready within %d s; see %s" % (self.name, START_LIMIT_S, self.log()))
            time.sleep(0.02)

    def signal(self, number):
        """Sends a signal to the process and its helpers, which share its process group."""
        if not self.runs():
            raise RuntimeError("%s does not run" % self.name)
        os.killpg(self.process.pid, number)

    def kill(self):
        self.signal(signal.SIGKILL)
        self.process.wait()
        return "KILLED"

    def pause(self):
        self.signal(signal.SIGSTOP)
        wait_until_frozen(self.process)
        return "PAUSED"

    def resume(self):
        self.signal(signal.SIGCONT)
        return "RESUMED"

    def stop(self):
        if self.runs():
            if self.grace_s:
                self.signal(signal.SIGCONT)
                self.signal(signal.SIGTERM)
                try:
                    self.process.wait(timeout=self.grace_s)
                    return "STOPPED"
                except subprocess.TimeoutExpired:
                    pass
            self.kill()
        return "STOPPED"

    def commands(self):
        return {"kill": self.kill, "start": self.start, "pause": self.pause, "resume": self.resume}


def options(description):
    """A parser of the arguments that all scripts have; a script may add its own before `run`."""
    parser = argparse.ArgumentParser(description="%s on loopback; commands come on stdin." % description)
    parser.add_argument("--dir", required=True, help="folder for configuration, data and logs")
    return parser


def add_client_options(parser):
    """Adds --port and --tls, for servers to which clients of the project connect."""
    parser.add_argument("--port", type=int, default=0, help="port for clients; default: a free one")
    parser.add_argument("--tls", action="store_true", help="TLS, client certificates, user and password; see "
                        "certificates.py")


def add_jvm_options(parser):
    parser.add_argument("--throughput", dest="jvm", action="store_const", const=THROUGHPUT, default=QUICK_START,
                        help="for benchmarks: more memory and a better compiler instead of a quick start")


def say(line):
    try:
        print(" ".join(line.split()), flush=True)
    except OSError:
        pass  # nobody reads any more; the end of stdin follows


def serve(server):
    say(server.start())
    commands = server.commands()
    for line in sys.stdin:
        words = line.split()
        if words == ["stop"]:
            return
        if not words or words[0] not in commands:
            say("ERROR no such command: %s; there are: %s stop" % (line.strip(), " ".join(commands)))
            continue
        try:
            inspect.signature(commands[words[0]]).bind(*words[1:])
        except TypeError as error:
            say("ERROR %s: %s" % (line.strip(), error))
            continue
        try:
            say(commands[words[0]](*words[1:]))
        except PASSING as error:
            say("ERROR %s" % error)


def require_label(*labels, of=True):
    """Raises RuntimeError unless one of these is a label of the test that runs (not `of`: unless none is). `./dev test`
    relies on labels when it installs and fetches servers. Outside of ctest everything is allowed."""
    test = os.environ.get("IOTCLOUD_TEST_LABELS", "").split(",")
    if test != [""] and any(label in test for label in labels) != of:
        raise RuntimeError("the labels of this test (%s) say that it needs no such server; give it other LABELS where "
                           "it is declared, as cmake/IotcloudTests.cmake tells" % " ".join(test))


def run(make):
    """Serves what `make()` returns until stdin ends, and ends the script with its status."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the starter too, which closes stdin
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    server, status = None, 0
    try:
        require_label("unit", "serverless", of=False)
        server = make()
        serve(server)
    except Unavailable as reason:
        # With CI=true every dependency must exist, so a suite that cannot run has failed.
        required = os.environ.get("CI") == "true"
        say("%s %s" % ("ERROR" if required else "SKIP", reason))
        status = 1 if required else 0
    except PASSING as error:
        say("ERROR %s" % error)
        status = 1
    finally:
        stopped = server.stop() if server else None
    if stopped and not status:
        say(stopped)
    sys.exit(status)
