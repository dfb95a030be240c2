"""Networks of their own for a test and for single processes in it: one process can be cut off from one server while it
reaches all others. Linux network namespaces, a veth pair and iptables; all of it is gone with the processes that use it.
"""

import contextlib
import ctypes
import os
import shutil
import subprocess
import sys
import urllib.request

LIBC = ctypes.CDLL("libc.so.6", use_errno=True)
CLONE_NEWNET = 0x40000000
SKIPPED = 77
MARK = "IOTCLOUD_TEST_HAS_ITS_NETWORK"
HERE, THERE = "10.77.0.1", "10.77.0.2"  # the two ends of the way between the test and the isle

PAGE_S = 60  # for a page of a busy machine
PROBE = "ip link set lo up && ip link add name here type veth peer name there && iptables -t nat -L -n && iptables -L -n"


def run(*command):
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise OSError(f"{' '.join(command)}: {done.stderr.strip() or done.stdout.strip()}")


def in_own_network(test):
    """Runs this script again in a network of its own, with a loopback that nobody else sees; returns in the new process
    only. Where that is not possible the script ends as skipped, which says why; for root with CI=true it fails."""
    if os.environ.get(MARK):
        return
    enter = ["unshare", "--net"] if os.geteuid() == 0 else ["unshare", "--map-root-user", "--net"]
    missing = [program for program in ("unshare", "ip", "iptables") if not shutil.which(program)]
    try:
        if missing:
            raise OSError("there is no " + ", ".join(missing) + "; install util-linux, iproute2, iptables")
        run(*enter, "sh", "-c", PROBE)
    except OSError as problem:
        print(f"SKIPPED {test}: no network namespaces here: {problem}", flush=True)
        sys.exit(1 if os.environ.get("CI") == "true" and os.geteuid() == 0 else SKIPPED)
    sys.stdout.flush()
    os.execvpe(enter[0], [*enter, sys.executable, *sys.argv], {**os.environ, MARK: "1"})


class Isle:
    """A second network, joined to the test's by one way; what listens on the test's loopback is reached at `HERE`.
    Use it in a `with` block, within in_own_network()."""

    def __enter__(self):
        self.holder = subprocess.Popen(["unshare", "--net", "sh", "-c", "echo && exec cat"],
                                       stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        self.holder.stdout.readline()
        self.space = f"/proc/{self.holder.pid}/ns/net"
        self.enter = ["nsenter", f"--net={self.space}"]
        run("ip", "link", "set", "lo", "up")
        run("ip", "link", "add", "out", "type", "veth", "peer", "name", "in", "netns", str(self.holder.pid))
        run("ip", "addr", "add", HERE + "/30", "dev", "out")
        run("ip", "link", "set", "out", "up")
        run(*self.enter, "ip", "link", "set", "lo", "up")
        run(*self.enter, "ip", "addr", "add", THERE + "/30", "dev", "in")
        run(*self.enter, "ip", "link", "set", "in", "up")
        with open("/proc/sys/net/ipv4/conf/out/route_localnet", "w", encoding="ascii") as setting:
            setting.write("1")
        run("iptables", "-t", "nat", "-A", "PREROUTING", "-i", "out", "-j", "DNAT", "--to-destination", "127.0.0.1")
        return self

    def __exit__(self, *_):
        self.holder.stdin.close()
        self.holder.wait()

    def cut(self, port):
        """Packets to and from that port of the test's network vanish without an error."""
        run(*self.enter, "iptables", "-A", "OUTPUT", "-p", "tcp", "--dport", str(port), "-j", "DROP")
        run(*self.enter, "iptables", "-A", "INPUT", "-p", "tcp", "--sport", str(port), "-j", "DROP")

    def mend(self):
        run(*self.enter, "iptables", "-F")

    @contextlib.contextmanager
    def inside(self):
        """Sockets that this thread opens meanwhile are in the isle."""
        with open("/proc/thread-self/ns/net") as ours, open(self.space) as theirs:
            self.move(theirs)
            try:
                yield
            finally:
                self.move(ours)

    @staticmethod
    def move(space):
        if LIBC.setns(space.fileno(), CLONE_NEWNET):
            raise OSError(ctypes.get_errno(), "setns")


def page(address, path, isle=None):
    with isle.inside() if isle else contextlib.nullcontext():
        with urllib.request.urlopen(f"http://{address}{path}", timeout=PAGE_S) as answer:
            return answer.read().decode()
