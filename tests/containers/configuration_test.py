#!/usr/bin/python3
"""Every configuration of deploy/cluster passes its daemon's own check, with secrets as `./dev cluster up` makes them, and so does
every topology that is to be submitted there.

usage: configuration_test.py BIN_DIR
"""

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
    for word in {word.strip(",}\"]") for word in text.split() if word.startswith("/run/secrets/")}:
        kind = next((kind for kind in ("gateway", "pool") if f"{{{kind}}}" in word), None)
        yield from {word.replace(f"{{{kind}}}", name) for name in services if name.startswith(f"{kind}-")} if kind else [word]


def check_submitted(programs, work, secrets, services):
    """The topologies name secrets that their workers' containers have."""
    files = sorted(CONFIGURATIONS.glob("submitted/*.yaml"))
    for original in files:
        service = "supervisor" if original.stem.endswith("-on-storm") else "pool-1"
        text = original.read_text(encoding="utf-8")
        for secret in secrets_named(text, services):
            if Path(secret).name not in cluster.FILES[service]:
                sys.exit(f"{original.name} names {secret}, which docker-compose.yml does not give to {service}")
        file = work / original.name
        file.write_text(text.replace("/run/secrets", str(secrets / service)), encoding="utf-8")
        done = run(programs / "iotcloud-topology", "--check", file)
        if done.returncode:
            sys.exit(f"{original.name}: {done.stderr or done.stdout}")
    return len(files)


def main():
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
                if Path(secret).name not in cluster.FILES[folder]:
                    sys.exit(f"{name} names {secret}, which docker-compose.yml does not give to its service")
        submitted = check_submitted(programs, Path(work), secrets, services)
    print(f"{len(used)} configurations and {submitted} topologies are good")


if __name__ == "__main__":
    main()
