"""A bare Debian 12 in a folder, for tests that install packages on it: made once by debootstrap from the mirror that this machine's
apt uses, with the archives of what the packages need, so that a test needs no network afterwards; and a systemd of its own in it.
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent / "servers"), str(HERE.parent / "containers")]

import images  # noqa: E402
from booted import GROUPS, SYSTEMD, BootedCluster, Space, skip  # noqa: E402
from private_cluster import require, wait_for  # noqa: E402
from private_docker import Failed  # noqa: E402

PATH = "/usr/sbin:/usr/bin:/sbin:/bin"
# The root becomes that of a space of mounts, with devices that every program may have.
BOOT = """
set -e
mount --make-rprivate /
mount --bind {root} {root}
cd {root}
mount -t proc proc proc
mount --bind proc/sys proc/sys
mount -o remount,ro,bind proc/sys
mount -t sysfs -o ro sysfs sys
mount -t tmpfs -o mode=0755 tmpfs run
mount -t tmpfs -o mode=1777 tmpfs tmp
mount -t tmpfs -o mode=0755 tmpfs dev
for device in null zero full random urandom tty; do touch dev/$device; mount --bind /dev/$device dev/$device; done
mkdir dev/shm dev/pts
mount -t tmpfs -o mode=1777 tmpfs dev/shm
mount -t devpts -o newinstance,ptmxmode=0666 devpts dev/pts
ln -s pts/ptmx dev/ptmx
mount -t tmpfs -o mode=0755 tmpfs .{group_folder}
{groups}
mount --bind {packages} media
pivot_root . mnt
exec chroot . /bin/sh -c 'umount -l /mnt; exec env -i container=iotcloud-test PATH={path} {systemd} --system --log-target=console \\
  --show-status=no'
"""


def run(*command, **options):
    """Runs a command. Returns (exit status, all that it said)."""
    done = subprocess.run([str(word) for word in command], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False,
                          stdin=subprocess.DEVNULL, **options)
    return done.returncode, done.stdout


def must(*command, **options):
    """Runs a command, and returns what it said. Ends the test with that when it fails."""
    status, said = run(*command, **options)
    require(status == 0, f"{' '.join(map(str, command))}: exit status {status}\n{said[-6000:]}")
    return said


def in_root(root, packages, *command):
    """Words that run a command in the folder as its root, with /proc and devices; its /media has the folder `packages`."""
    script = f"""set -e
mount --make-rprivate /
mount -t proc proc {root}/proc
mount --rbind /dev {root}/dev
mount --bind {packages} {root}/media
exec chroot {root} env -i PATH={PATH} DEBIAN_FRONTEND=noninteractive LC_ALL=C.UTF-8 "$@"
"""
    return ["unshare", "--mount", "--pid", "--fork", "--kill-child", "sh", "-c", script, "sh", *map(str, command)]


def make(folder):
    """A bare Debian in this folder. Raises Failed when it cannot be fetched."""
    print(f"a bare Debian 12 from this machine's mirror, once: {folder}", flush=True)
    site, environment = images.mirror()
    new = folder.with_suffix(".new")
    shutil.rmtree(new, ignore_errors=True)
    folder.parent.mkdir(parents=True, exist_ok=True)
    images.run("debootstrap", "--variant=minbase", "bookworm", new, site, env=environment)
    proxies = [f'Acquire::{name.removesuffix("_proxy")}::Proxy "{environment[name]}";\n' for name in ("http_proxy", "https_proxy")
               if name in environment]
    (new / "etc/apt/apt.conf.d/test").write_text("".join(proxies) + 'APT::Keep-Downloaded-Packages "true";\n'
                                                 'APT::Install-Recommends "false";\nAcquire::Check-Valid-Until "false";\n')
    for timer in ("apt-daily", "apt-daily-upgrade"):  # they would lock apt while the test uses it
        (new / f"etc/systemd/system/{timer}.timer").symlink_to("/dev/null")
    new.rename(folder)


def prepare(cache, packages):
    """The folder of a bare Debian in `cache`, with an archive of each of Debian's packages that the packages (.deb files of one folder)
    need. Made once; archives that are missing are fetched. Skips the test where they cannot be."""
    root = cache / "debian"
    try:
        if not root.exists():
            make(root)
    except Failed as problem:
        skip(f"no bare Debian: {problem}")
    shutil.copy("/etc/resolv.conf", root / "etc/resolv.conf")
    folder = packages[0].parent
    fetch = ["apt-get", "install", "--download-only", "-y", "-q", *(f"/media/{package.name}" for package in packages)]
    if run(*in_root(root, folder, *fetch, "--no-download"))[0]:
        print("archives of what the packages need, once", flush=True)
        must(*in_root(root, folder, "apt-get", "update", "-q"))
        must(*in_root(root, folder, *fetch))
    return root


class BareMachine(BootedCluster):
    """A private cluster's servers beside a bare Debian in a folder, which is booted."""

    def copy_root(self, prepared):
        self.root = self.out / "root"
        shutil.rmtree(self.root, ignore_errors=True)
        must("cp", "-a", prepared, self.root)
        (self.root / "etc/hostname").write_text("lab1\n")

    def before_boot(self, packages, script):
        """Types commands in the root of a machine that is not booted, in its folder /media, which has the folder `packages`. Returns
        what they say."""
        return must(*in_root(self.root, packages, "bash", "-e", "-c", f"cd /media\n{script}"))

    def boot_root(self, packages):
        """Boots the folder; its /media has the folder `packages`."""
        self.space = Space(f"iotcloud-bare-{os.getpid()}")
        groups = self.space.mounts().replace(str(GROUPS), f".{GROUPS}")
        boot = BOOT.format(root=self.root, group_folder=GROUPS, groups=groups, packages=packages, systemd=SYSTEMD, path=PATH)
        self.spawn("systemd", [*self.space.enter(), "/bin/sh", "-c", boot])
        wait_for("systemd is there", lambda: any(self.name_of(process) == "systemd\n" for process in self.descendants()))

    def inside(self, *words):
        return subprocess.run(["nsenter", "--target", str(self.first()), "--mount", "--pid", *words], capture_output=True, text=True,
                              timeout=600, check=False, stdin=subprocess.DEVNULL,
                              env={"PATH": PATH, "DEBIAN_FRONTEND": "noninteractive", "LC_ALL": "C.UTF-8"})
