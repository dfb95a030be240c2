"""Debian's Prometheus as a process of a test, on loopback. Its package would start a server on this machine and at every boot, so
only its two programs are taken out of it, once, into build/servers/prometheus.
"""

import fcntl
import json
import os
import shlex
import shutil
import subprocess
import tempfile
import urllib.parse
import urllib.request
from pathlib import Path

import yaml

from private_cluster import StartError, Unavailable, free_port, require, wait_for

FETCHED = Path(__file__).resolve().parents[2] / "build/servers"
LIMIT_S = 200


def fetch():
    """The folder with the programs. Raises Unavailable when the package cannot be had."""
    folder = FETCHED / "prometheus"
    FETCHED.mkdir(parents=True, exist_ok=True)
    with open(FETCHED / "prometheus.lock", "w", encoding="ascii") as lock, tempfile.TemporaryDirectory(dir=FETCHED) as work:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not folder.exists():
            download(work)
            (Path(work) / "usr/bin").rename(folder)
    return folder


def download(work):
    try:
        for command in ("apt-get download prometheus", "dpkg -x prometheus_*.deb ."):
            done = subprocess.run(["/bin/sh", "-c", command], cwd=work, stdin=subprocess.DEVNULL, capture_output=True, text=True,
                                  timeout=LIMIT_S, check=False)
            if done.returncode:
                raise Unavailable(f"{command}: {done.stderr.strip()}")
    except subprocess.TimeoutExpired as late:
        raise Unavailable(f"Debian's package prometheus did not come within {LIMIT_S} s") from late


def with_names(names, folder):
    """Words before a command: it takes these names for 127.0.0.1, and nobody else does. Raises Unavailable where one may not
    have mounts of one's own."""
    hosts = folder / "hosts"
    hosts.write_text(f"127.0.0.1 localhost {' '.join(names)}\n", encoding="ascii")
    user = [] if os.geteuid() == 0 else ["--user", "--map-root-user"]
    words = ["unshare", "--mount", *user, "/bin/sh", "-ec", f'mount --bind {shlex.quote(str(hosts))} /etc/hosts; exec "$@"', "sh"]
    tried = subprocess.run([*words, "true"], capture_output=True, text=True, check=False) if shutil.which("unshare") else None
    if not tried or tried.returncode:
        raise Unavailable(f"no mounts of its own: {tried.stderr.strip() if tried else 'there is no unshare'}")
    return words


def check(machine, sample, secrets, ports):
    """A Prometheus with the shipped file reads the pages of these daemons (`ports`, by their services) and has their metrics. Of
    the file only paths and ports are other ones, what is not here is left out, and it need not wait so long between two looks."""
    programs = fetch()
    checked = subprocess.run([programs / "promtool", "check", "config", "--syntax-only", sample], capture_output=True, text=True, check=False)
    require(checked.returncode == 0, f"promtool says of {sample.name}: {checked.stdout}{checked.stderr}")
    folder = machine.out / "prometheus"
    folder.mkdir()
    settings = yaml.safe_load(sample.read_text(encoding="utf-8").replace("/run/secrets", str(secrets / "prometheus")))
    settings["global"]["scrape_interval"] = "1s"
    kinds = set()
    for group in settings["scrape_configs"][0]["static_configs"]:
        here = [service for service in (target.split(":")[0] for target in group["targets"]) if service in ports]
        group["targets"] = [f"{service}:{ports[service]}" for service in here]
        kinds |= {group["labels"]["daemon"]} if here else set()
    configuration, port = folder / sample.name, free_port()
    configuration.write_text(yaml.safe_dump(settings), encoding="utf-8")
    machine.spawn("prometheus", [*with_names(ports, folder), programs / "prometheus", f"--config.file={configuration}",
                                 f"--web.listen-address=127.0.0.1:{port}", f"--storage.tsdb.path={folder}/data"])

    def asked(path):
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/api/v1/{path}", timeout=30) as answer:
            return json.load(answer)["data"]

    def all_are_up():
        machine.require_alive()
        found = {target["labels"]["instance"]: target["lastError"] or target["health"] for target in asked("targets")["activeTargets"]}
        if found != {f"{service}:{number}": "up" for service, number in ports.items()}:
            raise StartError(f"Prometheus says {found}")
        return True

    wait_for("Prometheus reads all daemons", all_are_up)
    # Its answers are a moment behind what it reads.
    query = urllib.parse.quote('count by (daemon) ({__name__=~"iotcloud_.+"})')
    wait_for(f"Prometheus has metrics of {sorted(kinds)}",
             lambda: {one["metric"]["daemon"] for one in asked(f"query?query={query}")["result"]} == kinds)
    print(f"a Prometheus with {sample.name} reads {', '.join(ports)}")
