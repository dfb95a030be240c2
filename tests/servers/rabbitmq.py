#!/usr/bin/python3
"""A private RabbitMQ for tests and demos, on loopback only, that leaves nothing behind.

    rabbitmq.py --dir DIR [--port N]

Runs one node with its data, logs and Erlang cookie below DIR, with its own port mapper (epmd), on free ports. When the
node takes connections it prints one line on stdout:

    READY amqp://guest:guest@127.0.0.1:PORT/

Then it obeys one command for each line of stdin and answers with one line on stdout:

    kill    SIGKILL to the node                    KILLED
    start   starts it again, same port and data    READY amqp://...
    pause   SIGSTOP to the node: it hangs          PAUSED
    resume  SIGCONT                                RESUMED
    alarm   memory alarm: it takes no messages     ALARM
    clear   ends the alarm                         CLEAR
    stop    ends everything                        STOPPED

The end of stdin means `stop`, so the server ends with whoever started it. A command that fails answers `ERROR text`.
Data of an earlier run in DIR are kept: durable queues come back.
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

PROGRAMS = "/usr/lib/rabbitmq/bin"  # those in /usr/sbin change the user, which fails for private folders
START_LIMIT_S = 90
PR_SET_PDEATHSIG = 1
LIBC = ctypes.CDLL("libc.so.6", use_errno=True)


def become_child():
    """In a child before exec: an own process group, and death with the parent."""
    os.setpgid(0, 0)
    LIBC.prctl(PR_SET_PDEATHSIG, signal.SIGKILL)


def free_ports(count):
    """Ports that are free now, below the range from which the kernel takes ports for outgoing connections: while the
    node is down between `kill` and `start` no client's socket can take its port."""
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
        if port not in found:
            found.append(port)
    return found


class RabbitMq:
    def __init__(self, folder, port):
        self.folder = os.path.abspath(folder)
        os.makedirs(self.folder, exist_ok=True)
        ports = free_ports(3)
        self.port = port or ports[0]
        self.distribution_port, self.epmd_port = ports[1:]
        self.node_name = "iotcloud%d@localhost" % self.port
        self.epmd = None
        self.node = None
        with open(self.path("rabbitmq.conf"), "w", encoding="ascii") as file:
            file.write("listeners.tcp.1 = 127.0.0.1:%d\n" % self.port)
            file.write("num_acceptors.tcp = 2\nlog.file.level = info\n")
            # A test's disk may be nearly full; an alarm would block every publisher.
            file.write("disk_free_limit.absolute = 50MB\n")
        with open(self.path("enabled_plugins"), "w", encoding="ascii") as file:
            file.write("[].\n")

    def path(self, *parts):
        return os.path.join(self.folder, *parts)

    def environment(self):
        env = {key: value for key, value in os.environ.items()
               if not key.startswith(("RABBITMQ_", "ERL_", "ELIXIR_")) and key != "NOTIFY_SOCKET"}
        env.update({
            "HOME": self.folder,  # the Erlang cookie
            "LC_ALL": "C.UTF-8",
            "ERL_EPMD_ADDRESS": "127.0.0.1",
            "ERL_EPMD_PORT": str(self.epmd_port),
            "ERL_CRASH_DUMP": self.path("erl_crash.dump"),
            "RABBITMQ_ALLOW_INPUT": "1",  # the script becomes the node: no shell between it and its process id
            "RABBITMQ_NODENAME": self.node_name,
            "RABBITMQ_DIST_PORT": str(self.distribution_port),
            "RABBITMQ_MNESIA_BASE": self.path("data"),
            "RABBITMQ_LOG_BASE": self.path("log"),
            "RABBITMQ_LOGS": self.path("log", "rabbit.log"),
            "RABBITMQ_PID_FILE": self.path("rabbit.pid"),
            "RABBITMQ_GENERATED_CONFIG_DIR": self.path("generated"),
            "RABBITMQ_CONFIG_FILE": self.path("rabbitmq.conf"),
            "RABBITMQ_CONF_ENV_FILE": "/dev/null",
            "RABBITMQ_ADVANCED_CONFIG_FILE": self.path("advanced.config"),
            "RABBITMQ_ENABLED_PLUGINS_FILE": self.path("enabled_plugins"),
            "RABBITMQ_SERVER_ADDITIONAL_ERL_ARGS":
                "-noinput +S 2:2 +A 8 -start_epmd false -kernel inet_dist_use_interface {127,0,0,1}",
        })
        return env

    def start(self):
        if self.node and self.node.poll() is None:
            raise RuntimeError("the node runs already")
        if not self.epmd or self.epmd.poll() is not None:
            self.epmd = subprocess.Popen(["epmd", "-address", "127.0.0.1", "-port", str(self.epmd_port)],
                                         stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
                                         stderr=subprocess.DEVNULL, preexec_fn=become_child)
            self.wait_for("the port mapper", self.epmd, self.epmd_answers)
        os.makedirs(self.path("log"), exist_ok=True)
        with open(self.path("log", "console.log"), "ab") as console:
            self.node = subprocess.Popen([PROGRAMS + "/rabbitmq-server"], env=self.environment(), cwd=self.folder,
                                         stdin=subprocess.DEVNULL, stdout=console, stderr=console,
                                         preexec_fn=become_child)
        self.wait_for("RabbitMQ", self.node, self.takes_connections)
        return "READY amqp://guest:guest@127.0.0.1:%d/" % self.port

    def epmd_answers(self):
        with socket.create_connection(("127.0.0.1", self.epmd_port), timeout=1):
            return True

    def takes_connections(self):
        """The node opens its port last of all, and greets when it is ready."""
        with socket.create_connection(("127.0.0.1", self.port), timeout=1) as probe:
            probe.settimeout(5)
            probe.sendall(b"AMQP\x00\x00\x09\x01")
            return probe.recv(1) == b"\x01"  # a method frame: connection.start

    def wait_for(self, what, process, ready):
        limit = time.monotonic() + START_LIMIT_S
        while True:
            try:
                if ready():
                    return
            except OSError:
                pass
            if process.poll() is not None:
                raise RuntimeError("%s ended with status %d; see %s" % (what, process.returncode, self.path("log")))
            if time.monotonic() > limit:
                raise RuntimeError("%s was not ready within %d s; see %s" % (what, START_LIMIT_S, self.path("log")))
            time.sleep(0.02)

    def signal(self, number):
        """To the node and its helpers (name resolution, disk monitor): they share its process group."""
        if not self.node or self.node.poll() is not None:
            raise RuntimeError("the node does not run")
        os.killpg(self.node.pid, number)

    def kill(self):
        self.signal(signal.SIGKILL)
        self.node.wait()
        return "KILLED"

    def pause(self):
        self.signal(signal.SIGSTOP)
        return "PAUSED"

    def resume(self):
        self.signal(signal.SIGCONT)
        return "RESUMED"

    def control(self, *arguments):
        subprocess.run([PROGRAMS + "/rabbitmqctl", "-n", self.node_name, *arguments], env=self.environment(),
                       stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, check=True, timeout=60,
                       preexec_fn=become_child)

    def alarm(self):
        self.control("set_vm_memory_high_watermark", "0")
        return "ALARM"

    def clear(self):
        self.control("set_vm_memory_high_watermark", "0.4")
        return "CLEAR"

    def stop(self):
        """A short grace for the node to write its data, then the end."""
        if self.node and self.node.poll() is None:
            os.killpg(self.node.pid, signal.SIGCONT)
            os.killpg(self.node.pid, signal.SIGTERM)
            try:
                self.node.wait(timeout=10)
            except subprocess.TimeoutExpired:
                os.killpg(self.node.pid, signal.SIGKILL)
                self.node.wait()
        if self.epmd and self.epmd.poll() is None:
            self.epmd.kill()
            self.epmd.wait()
        return "STOPPED"


def say(line):
    try:
        print(line, flush=True)
    except OSError:
        pass  # whoever listened is gone; the end of stdin follows


def serve(server):
    commands = {"kill": server.kill, "start": server.start, "pause": server.pause, "resume": server.resume,
                "alarm": server.alarm, "clear": server.clear}
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
        except (RuntimeError, OSError, subprocess.SubprocessError) as error:
            say("ERROR %s" % error)


def main():
    parser = argparse.ArgumentParser(description="A private RabbitMQ on loopback; commands come on stdin.")
    parser.add_argument("--dir", required=True, help="folder for data, logs and the Erlang cookie")
    parser.add_argument("--port", type=int, default=0, help="AMQP port; default: a free one")
    arguments = parser.parse_args()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the starter too, which closes stdin
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    server = RabbitMq(arguments.dir, arguments.port)
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
