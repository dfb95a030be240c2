#!/usr/bin/python3
"""Every configuration of deploy/cluster passes its daemon's own check, with secrets as `./dev cluster up` makes them, and so does
every topology that is to be submitted there. `./dev cluster tokens renew` puts off the end that all tokens have, and `./dev cluster
passwords renew` replaces the workers' passwords everywhere.

usage: configuration_test.py BIN_DIR
"""

import json
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path
from unittest import mock

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


def ends_of_tokens(folder):
    """By file and holder, when each token ends, in seconds."""
    found = {}
    for file in folder.glob("*.tokens"):
        for line in file.read_text(encoding="utf-8").splitlines():
            holder, role, *_ = line.split(":") if line and not line.startswith("#") else ("", "")
            if holder:
                found[file.name, holder] = role.partition("/")[2]
    return found


def check_tokens(programs, secrets):
    """Every token has an end, which is put off without another token."""
    authority = secrets / "authority"
    if never := [which for which, end in ends_of_tokens(authority).items() if not end]:
        sys.exit(f"these tokens count for ever: {never}")
    for file, holder in ends_of_tokens(authority):
        run(programs / "iotcloud", "token", "renew", holder, "--days", "1", "--file", authority / file)
    before, kept = ends_of_tokens(authority), (authority / "admin.token").read_text(encoding="utf-8")
    path = f"{programs}:{os.environ['PATH']}"
    with mock.patch.multiple(cluster, Docker=lambda: cluster_secrets.OnThisMachine(programs / "iotcloud", authority),
                             environment=lambda: {**os.environ, "PATH": path}):
        cluster.tokens(None)
    after = ends_of_tokens(authority)
    if not before or set(before) != set(after) or any(after[which] <= before[which] for which in before):
        sys.exit(f"after `./dev cluster tokens renew` tokens end at {after}, before at {before}")
    if (authority / "admin.token").read_text(encoding="utf-8") != kept:
        sys.exit("`./dev cluster tokens renew` gives the operator another token")
    given = {f"{service}/{name}" for service, files in cluster.FILES.items() for name, source in files.items()
             if source.endswith(".tokens") and (secrets / service / name).read_bytes() != (authority / source).read_bytes()}
    if given:
        sys.exit(f"these services do not get the renewed tokens: {given}")


def check_passwords(programs, secrets):
    """Every password of the workers is another one in every file that has it, users and rights stay, and what has read the old ones
    is told or starts again."""
    authority = secrets / "authority"
    files = {file.name: file.read_text(encoding="utf-8") for file in authority.iterdir() if file.is_file()}
    names = [f"workers.{what}.password" for what in ("registry", "rabbitmq", "kafka")]
    told, services = [], ["kafka", "rabbitmq", "zookeeper", *cluster.MASTERS, *cluster.GATEWAYS, *cluster.WORKERS, *cluster.POOLS]
    docker = cluster_secrets.OnThisMachine(programs / "iotcloud", authority)
    docker.containers = lambda: {service: {"Id": service, "State": {"Running": True}} for service in services}
    with mock.patch.multiple(cluster, Docker=lambda: docker, asked=lambda command: told.append(" ".join(command))):
        cluster.passwords(None)
    after = {name: (authority / name).read_text(encoding="utf-8") for name in files}
    changed = {name for name in files if files[name] != after[name]}
    if changed != {*names, "registry.users", "rabbitmq.users.json", "kafka.server.jaas"}:
        sys.exit(f"`./dev cluster passwords renew` changes {sorted(changed)}")
    for name in names:
        if any(files[name].strip() in text for text in after.values()):
            sys.exit(f"the old {name} is left")
    if f'user_workers="{after[names[2]].strip()}"' not in after["kafka.server.jaas"]:
        sys.exit("Kafka does not know the workers' other password")
    of_workers = [line for line in after["registry.users"].splitlines() if line.startswith("worker ")]
    if len(of_workers) != 1 or len(after["registry.users"].splitlines()) != len(files["registry.users"].splitlines()):
        sys.exit(f"the registry's users are {after['registry.users']}")
    before, now = (json.loads(text["rabbitmq.users.json"]) for text in (files, after))
    for users in (before["users"], now["users"]):
        next(user for user in users if user["name"] == "workers").pop("password_hash")
    if before != now:
        sys.exit(f"RabbitMQ's users are {now}")
    given = {f"{service}/{name}" for service, mounted in cluster.FILES.items() for name, source in mounted.items()
             if source in changed and (secrets / service / name).read_bytes() != (authority / source).read_bytes()}
    if given:
        sys.exit(f"these services do not get the other passwords: {given}")
    restarted = next((line.split()[2:] for line in told if line.startswith("docker restart ")), [])
    if set(restarted) != set(services) - {"rabbitmq", "zookeeper"} or not told[0].startswith("docker exec rabbitmq rabbitmqctl import_definitions"):
        sys.exit(f"`./dev cluster passwords renew` tells Docker {told}")
    if "close_all_user_connections workers" not in told[1] or not told[-1].startswith("docker exec master-1 iotcloud registry rights"):
        sys.exit(f"`./dev cluster passwords renew` tells Docker {told}")


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
        check_tokens(programs, secrets)
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
        check_passwords(programs, secrets)
    print(f"{len(used)} configurations and {len(submitted)} topologies are good")


if __name__ == "__main__":
    main()
