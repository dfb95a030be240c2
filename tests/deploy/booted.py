"""A systemd of its own for tests of the shipped units: the first process of a space of processes and mounts, with no unit but
those given, and the users that the shipped file for systemd-sysusers makes. Such spaces take root; who may not have them skips
the test.
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "servers"))

from private_cluster import PrivateCluster, wait_for  # noqa: E402

SKIPPED = 77
SYSTEMD = "/lib/systemd/systemd"
GROUPS = Path("/sys/fs/cgroup")
TARGETS = ("sysinit", "basic", "sockets", "network-online", "shutdown", "umount")

# In its own space of mounts. What the units call /usr/bin and /var/lib is empty there but for what the test needs, and /etc is
# a copy; SYSTEMD_UNIT_PATH leaves out all units of this machine.
BOOT = """
set -e
mount --make-rprivate /
mount -t proc proc /proc
for folder in /run /opt /var/lib /sys/fs/cgroup; do mount -t tmpfs -o mode=0755 tmpfs $folder; done
{groups}
mkdir /opt/units /opt/iotcloud
cp -a /etc /run/etc
mount --bind /run/etc /etc
systemd-sysusers {users}
cp {files} /opt/iotcloud
cp -r {units}/* /opt/units
{prepare}
exec env -i container=iotcloud-test PATH=/usr/bin:/bin SYSTEMD_UNIT_PATH=/opt/units {systemd} --system --unit=test.target \\
  --log-target=console --show-status=no
"""


def skip(why):
    print(f"SKIPPED: {why}")
    sys.exit(SKIPPED)


def require_means():
    """Skips the test where systemd cannot be booted so. development/summary.py knows the texts of what a machine may lack."""
    if os.geteuid() != 0:
        skip("only root can boot a systemd")
    if not Path(SYSTEMD).exists() or not shutil.which("unshare"):
        skip("systemd and unshare are needed")
    done = subprocess.run(["unshare", "--mount", "--pid", "--fork", "true"], capture_output=True, text=True, check=False)
    if done.returncode:
        skip(f"no name spaces of its own: {done.stderr.strip()}")


class Space:
    """Groups of processes (cgroups) for a systemd that is not this machine's, and the words that begin its spaces."""

    def __init__(self, name):
        self.unified = (GROUPS / "cgroup.procs").exists()
        # With version 1 there is a tree for each controller; systemd makes groups in all that it finds.
        trees = [GROUPS] if self.unified else [file.parent for file in GROUPS.glob("*/cgroup.procs") if not file.parent.is_symlink()]
        self.groups = [tree / name for tree in trees]
        if not self.groups:
            skip(f"no cgroups in {GROUPS}")
        for group in self.groups:
            try:
                group.mkdir()
            except OSError as error:
                self.remove()
                skip(f"no cgroup of its own: {error}")
            for setting in ("cpuset.cpus", "cpuset.mems"):  # without them nobody may be in the group
                if (group / setting).exists() and not self.unified:
                    (group / setting).write_text((group.parent / setting).read_text())

    def enter(self):
        """Words before a command, which make it the first process of its space, in these groups."""
        join = "; ".join(f"echo $$ >{group}/cgroup.procs" for group in self.groups)
        return ["/bin/sh", "-c", f'set -e; {join}; exec unshare --mount --pid --cgroup --uts --ipc --fork --kill-child "$@"', "sh"]

    def mounts(self):
        """Commands in its space of mounts, after which these groups are all that it sees."""
        if self.unified:
            return f"mount -t cgroup2 cgroup {GROUPS}"
        return "\n".join(f"mkdir {tree}; mount -t {kind} cgroup {tree}" for tree, kind in (
            (GROUPS / "systemd", "cgroup -o none,name=systemd"), (GROUPS / "unified", "cgroup2"),
            (GROUPS / "pids", "cgroup -o pids")) if tree.exists())

    def counts_processes(self):
        """Whether TasksMax= of a unit has an effect: the kernel counts the processes of these groups."""
        return not self.unified or "pids" in (self.groups[0] / "cgroup.controllers").read_text().split()

    def remove(self):
        """When all processes have ended, which the kernel does soon after the first one's end."""
        for group in self.groups:
            wait_for(f"{group} is empty", lambda group=group: self.removed(group))

    @staticmethod
    def removed(group):
        try:
            for folder, _, _ in os.walk(group, topdown=False):
                os.rmdir(folder)
        except OSError:
            return False
        return True


class BootedCluster(PrivateCluster):
    """A private cluster of which systemd starts some daemons."""

    def boot(self, units, known, started, files, prepare):
        """`units`: the folder of the shipped ones; `known`: texts of those that systemd is to know, by their names, with
        programs in /opt/iotcloud; `started`: names of those that it starts; `files`: for /opt/iotcloud; `prepare`:
        commands before systemd is started."""
        self.space = Space(f"iotcloud-booted-{os.getpid()}")
        own = self.out / "units"
        own.mkdir()
        for unit, text in known.items():
            (own / unit).parent.mkdir(exist_ok=True)
            (own / unit).write_text(text)
        for name in TARGETS:
            (own / f"{name}.target").write_text("[Unit]\nDefaultDependencies=no\n")
        (own / "test.target").write_text(f"[Unit]\nDefaultDependencies=no\nWants={' '.join(started)}\n")
        boot = BOOT.format(files=" ".join(map(str, files)), units=own, systemd=SYSTEMD, prepare=prepare,
                           users=units / "iotcloud.sysusers", groups=self.space.mounts())
        self.spawn("systemd", [*self.space.enter(), "/bin/sh", "-c", boot])

    def stop(self, limit=10):
        for name, child in self.children:
            if name == "systemd":  # SIGTERM would only make it start itself again; with it all of its space ends
                child.kill()
                child.wait()
        super().stop(limit)
        if hasattr(self, "space"):
            self.space.remove()

    def first(self):
        """systemd's own process."""
        return next(process for process in self.descendants() if self.name_of(process) == "systemd\n")

    @staticmethod
    def name_of(process):
        try:
            return Path(f"/proc/{process}/comm").read_text()
        except OSError:  # it has ended since it was listed
            return ""

    def inside(self, *words):
        """Runs a command in systemd's spaces of mounts and processes."""
        return subprocess.run(["nsenter", "--target", str(self.first()), "--mount", "--pid", *words], capture_output=True,
                              text=True, timeout=300, check=False, env={"PATH": "/usr/bin:/bin"})

    def systemctl(self, *words):
        return self.inside("systemctl", *words)


def with_own_programs(text):
    """A shipped unit with its programs in /opt/iotcloud."""
    return text.replace("/usr/bin/iotcloud-", "/opt/iotcloud/iotcloud-")


def status_of(process, key):
    """Words of a line in a process's status."""
    return next(line.split()[1:] for line in Path(f"/proc/{process}/status").read_text().splitlines() if line.startswith(key + ":"))
