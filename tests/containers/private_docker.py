"""A Docker daemon of a test's own: in a network namespace of its own, with its own data, socket and process ids, beside
whatever else runs on the machine. It and all that it made are gone at the end of the `with` block.
"""

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "servers"))

from private_server import die_with_parent  # noqa: E402

PROGRAMS = {"dockerd": "docker.io", "docker-compose": "docker-compose", "debootstrap": "debootstrap", "ip": "iproute2",
            "iptables": "iptables", "nsenter": "util-linux"}
CLIENTS = "/usr/sbin:/usr/bin:/sbin:/bin"  # Debian's own clients, which fit its daemon
START_LIMIT_S, STOP_LIMIT_S = 60, 60


class Failed(Exception):
    """A command failed; the text contains its output."""


def run(*command, **options):
    done = subprocess.run([str(word) for word in command], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
                          **options)
    if done.returncode:
        raise Failed(f"{' '.join(map(str, command))}: status {done.returncode}\n{done.stdout.strip()}")
    return done.stdout.strip()


def install_programs():
    missing = sorted({package for program, package in PROGRAMS.items() if not shutil.which(program, path=CLIENTS)})
    if not missing:
        return
    print(f"installing {', '.join(missing)}", flush=True)
    policy = Path("/usr/sbin/policy-rc.d")  # packages must not start a system-wide daemon
    ours = not policy.exists()
    if ours:
        policy.write_text("#!/bin/sh\nexit 101\n", encoding="ascii")
        policy.chmod(0o755)
    try:
        run("apt-get", "update", "-q")
        run("apt-get", "install", "-y", "-q", "--no-install-recommends", *missing,
            env={**os.environ, "DEBIAN_FRONTEND": "noninteractive"})
    finally:
        if ours:
            policy.unlink()


def end_on_signals():
    """SIGTERM and SIGHUP end the test in order, as Ctrl-C does."""
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda received, _: sys.exit(128 + received))


class PrivateDocker:
    def __init__(self, log):
        self.log = Path(log)
        self.space = f"iotcloud-docker-{os.getpid()}"
        self.enter = ["nsenter", f"--net=/run/netns/{self.space}"]

    def __enter__(self):
        # Short, because it has sockets in it.
        self.folder = Path(tempfile.mkdtemp(prefix="iotcloud-docker-"))
        self.host = f"unix://{self.folder}/docker.sock"
        self.environment = {**os.environ, "DOCKER_HOST": self.host, "DOCKER_BUILDKIT": "1", "PATH": CLIENTS}
        self.daemon = None
        try:
            self.start()
        except BaseException:
            self.__exit__()
            raise
        return self

    def start(self):
        run("ip", "netns", "add", self.space)
        run(*self.enter, "ip", "link", "set", "lo", "up")
        command = [*self.enter, "dockerd", "--data-root", self.folder / "data", "--exec-root", self.folder / "exec",
                   "--host", self.host, "--pidfile", self.folder / "docker.pid", "--cgroup-parent", self.space]
        with open(self.log, "w", encoding="utf-8") as log:
            self.daemon = subprocess.Popen([str(word) for word in command], stdin=subprocess.DEVNULL, stdout=log,
                                           stderr=subprocess.STDOUT, env=self.environment, start_new_session=True,
                                           preexec_fn=die_with_parent)
        deadline = time.monotonic() + START_LIMIT_S
        while True:
            if self.daemon.poll() is not None or time.monotonic() > deadline:
                raise Failed(f"dockerd did not start; see {self.log}")
            try:
                self.docker("version")
                return
            except Failed:
                time.sleep(0.1)

    def __exit__(self, *_):
        if self.daemon:
            containers = self.docker("ps", "-aq").split() if self.daemon.poll() is None else []
            if containers:
                self.docker("rm", "-f", "-v", *containers)
            self.daemon.terminate()
            try:
                self.daemon.wait(STOP_LIMIT_S)
            except subprocess.TimeoutExpired:
                print(f"dockerd did not stop within {STOP_LIMIT_S} s and is killed; see {self.log}")
                self.daemon.kill()
                self.daemon.wait()
        mounts = [line.split()[1] for line in Path("/proc/self/mounts").read_text(encoding="utf-8").splitlines()]
        for mount in reversed([mount for mount in mounts if mount.startswith(f"{self.folder}/")]):
            run("umount", mount)
        if Path(f"/run/netns/{self.space}").exists():
            run("ip", "netns", "delete", self.space)
        for group in Path("/sys/fs/cgroup").glob(f"**/{self.space}"):
            for folder in sorted([path for path in group.rglob("*") if path.is_dir()], reverse=True) + [group]:
                folder.rmdir()
        shutil.rmtree(self.folder)

    def docker(self, *words):
        """The output of `docker WORDS`. Raises Failed."""
        return run("docker", *words, env=self.environment)

    def inside(self, *command, **options):
        """Runs a command where the daemon publishes ports, with its output on this process's own."""
        return subprocess.run([*self.enter, *map(str, command)], env=self.environment, **options)

    def import_image(self, tag, archive):
        with open(archive, "rb") as file:
            run("docker", "import", "-", tag, env=self.environment, stdin=file)
