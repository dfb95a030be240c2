#!/usr/bin/python3
"""Every configuration of deploy/cluster passes its daemon's own check, with secrets as `./dev cluster up` makes them, and so does
every topology that is to be submitted there.

usage: configuration_test.py BIN_DIR
"""

import re
import subprocess
import sys
import tempfile
from pathlib import Path

import yaml

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "deploy/cluster"))

import cluster  # noqa: E402  (its folder is known now)
import cluster_secrets  # noqa: E402
from compose_file_test import folder_of  # noqa: E402

CONFIGURATIONS = ROOT / "deploy/cluster"
DAEMONS = {"iotcloud-master", "iotcloud-gateway", "iotcloud-topology"}


def run(*command):
    return subprocess.run([str(word) for word in command], capture_output=True, text=True, timeout=60)


def secrets_named(text, services):
    """The files of /run/secrets that a configuration names; {gateway} stands for each gateway, {pool} for each pool."""
    for word in set(re.findall(r"/run/secrets/(?:\{\w+\}|[^\s,}\]\"])+", text)):
        kind = next((kind for kind in ("gateway", "pool") if f"{{{kind}}}" in word), None)
        yield from {word.replace(f"{{{kind}}}", name) for name in services if name.startswith(f"{kind}-")} if kind else [word]


def is_given(secret, service):
    """Whether a service has this file, or files in this folder."""
    name = secret.removeprefix("/run/secrets/")
    return any(given == name or given.startswith(f"{name}/") for given in cluster.FILES[service])


def is_for_storm(topology):
    return topology.stem.endswith("-on-storm")


def check_what_workers_reach(submitted):
    """A worker of a pool reaches what the topologies name that are there to be submitted, and nothing that is its pool's alone:
    whoever has a component in it would be the pool for masters, and for what pools of other machines ask."""
    for pool in cluster.POOLS:
        configuration = yaml.safe_load((CONFIGURATIONS / f"{pool}.yaml").read_text(encoding="utf-8"))
        folders = configuration["worker_files"]["read"]

        def reached(secret):
            return any(secret == folder or secret.startswith(f"{folder}/") for folder in folders)

        for own in ("host.key", "tokens", "health.token"):
            if reached(f"/run/secrets/{own}"):
                sys.exit(f"{pool}.yaml: its workers read {own}")
        sources = {source for name, source in cluster.FILES[pool].items() if reached(f"/run/secrets/{name}")}
        if f"{pool}.key" in sources:
            sys.exit(f"{pool}.yaml: its workers read its key")
        for file in submitted:
            for secret in secrets_named(file.read_text(encoding="utf-8"), []):
                if not is_for_storm(file) and not reached(secret):
                    sys.exit(f"{file.name} names {secret}, which the workers of {pool} do not reach")


def check_submitted(programs, work, secrets, submitted):
    """The topologies are good, and name secrets that their workers' containers have."""
    for original in submitted:
        service = "supervisor" if is_for_storm(original) else cluster.POOLS[0]
        text = original.read_text(encoding="utf-8")
        for secret in secrets_named(text, []):
            if not is_given(secret, service):
                sys.exit(f"{original.name} names {secret}, which docker-compose.yml does not give to {service}")
        file = work / original.name
        file.write_text(text.replace("/run/secrets", str(secrets / service)), encoding="utf-8")
        done = run(programs / "iotcloud-topology", "--check", file)
        if done.returncode:
            sys.exit(f"{original.name}: {done.stderr or done.stdout}")


def main():
    submitted = sorted(CONFIGURATIONS.glob("submitted/*.yaml"))
    check_what_workers_reach(submitted)
    programs = Path(sys.argv[1]).resolve()
    services = yaml.safe_load((ROOT / "docker-compose.yml").read_text(encoding="utf-8"))["services"]
    commands = [service["command"][1:] for service in services.values()
                if service.get("command", [""])[0] == "iotcloud-with-registry-tunnel"]
    used = {Path(words[-1]).name: words[:-1] for words in commands if words[0] in DAEMONS}
    files = {file.name for file in CONFIGURATIONS.glob("*.yaml")}
    if set(used) != files:
        sys.exit(f"deploy/cluster has {sorted(files)}, docker-compose.yml uses {sorted(used)}")
    with tempfile.TemporaryDirectory(dir=programs.parent) as work:
        secrets = Path(work) / "secrets"
        cluster_secrets.make(programs, secrets)
        for name, command in sorted(used.items()):
            original = text = (CONFIGURATIONS / name).read_text(encoding="utf-8")
            folder = folder_of(next(service for service in services.values()
                                    if service.get("command", [""])[-1] == f"/etc/iotcloud/{name}"))
            file = Path(work) / name
            here = {"/run/secrets": str(secrets / folder), "/usr/lib/iotcloud/plugins": str(programs.parent / "plugins")}
            for there, path in here.items():
                text = text.replace(there, path)
            file.write_text(text, encoding="utf-8")
            done = run(programs / command[0], *command[1:], file, "--check-config")
            if done.returncode:
                sys.exit(f"{name}: {done.stderr or done.stdout}")
            # The daemon refuses unknown keys here.
            file.write_text(file.read_text(encoding="utf-8") + "\nnonsense: 1\n", encoding="utf-8")
            if run(programs / command[0], *command[1:], file, "--check-config").returncode == 0:
                sys.exit(f"{' '.join(command)} --check-config takes nonsense")
            # The compose file defines where services and secrets are.
            for secret in secrets_named(original, services):
                if not is_given(secret, folder):
                    sys.exit(f"{name} names {secret}, which docker-compose.yml does not give to its service")
        check_submitted(programs, Path(work), secrets, submitted)
    print(f"{len(used)} configurations and {len(submitted)} topologies are good")


if __name__ == "__main__":
    main()
