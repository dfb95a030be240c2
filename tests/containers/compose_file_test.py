#!/usr/bin/python3
"""docker-compose.yml keeps its promises: no service without limits, health check and restart policy, nothing on the host's
network or privileged, no secret in the file, ports on loopback only, nothing said to ZooKeeper without TLS.

usage: compose_file_test.py
"""

import copy
import re
import sys
from pathlib import Path

import yaml

ROOT = Path(__file__).resolve().parents[2]
SERVICES = {"zookeeper", "registry-tls", "rabbitmq", "kafka", "master-1", "master-2", "gateway-1", "gateway-2", "topology-1", "topology-2"}
DAEMONS = {"master-1", "master-2", "gateway-1", "gateway-2", "topology-1", "topology-2"}
RUN_ONCE = {"bench", "cli", "secrets"}  # by a person, or by ./dev cluster
# What gateways may share with others: all but the broker's password is public.
SHARED = {"ca.pem", "revoked.pem", "registry.users", "master-1.orders.pub", "master-2.orders.pub", "rabbitmq.password"}
FORBIDDEN = ["privileged", "pid", "ipc", "userns_mode", "devices", "cgroup_parent", "env_file"]
SECRET_WORD = re.compile(r"(?i)(password|passwd|pass|token|secret|credential)[a-z_]*$")


def problems_of(file):
    """The errors of a compose file, as sentences."""
    found = []
    services = file["services"]
    for name in (SERVICES | RUN_ONCE) ^ set(services):
        found.append(f"{name} is in one of the file and this test only")
    for name, service in services.items():
        found += [f"{name} {problem}" for problem in problems_of_service(name, service, services, file["secrets"])]
    found += shared_secrets(services)
    found += ways_around_the_tunnel(file)
    for name, secret in file["secrets"].items():
        if set(secret) != {"file"}:
            found.append(f"secret {name} is not a file")
    return found


def secrets_of(service):
    return {secret if isinstance(secret, str) else secret["source"] for secret in service.get("secrets", [])}


def shared_secrets(services):
    """What the thief of one gateway has is of no use elsewhere: it shares no secret with another service."""
    for name in sorted(SERVICES & set(services)):
        for other in sorted(SERVICES & set(services) - {name}) if name.startswith("gateway-") else []:
            for secret in sorted(secrets_of(services[name]) & secrets_of(services[other]) - SHARED):
                yield f"{name} shares the secret {secret} with {other}"


def ways_around_the_tunnel(file):
    """Only registry-tls is on ZooKeeper's network, and each daemon has a tunnel to it, with a certificate."""
    services = file["services"]
    if file.get("networks") != {"registry": {"internal": True}}:
        yield "the network of ZooKeeper leads elsewhere"
    for name, service in services.items():
        networks = {"zookeeper": ["registry"], "registry-tls": ["default", "registry"]}.get(name)
        if service.get("networks") != networks:
            yield f"{name} is on the networks {service.get('networks')}"
        if name in DAEMONS:
            if service["command"][0] != "iotcloud-with-registry-tunnel":
                yield f"{name} has no tunnel to the registry"
            targets = {secret["target"] for secret in service["secrets"] if isinstance(secret, dict)}
            if not {"host.pem", "host.key"} <= targets or not {"ca.pem", "revoked.pem"} <= secrets_of(service):
                yield f"{name} has no certificate, authority or list of revoked certificates for its tunnel"


def directives(file):
    return {line for line in file.read_text(encoding="utf-8").splitlines() if line and not line.startswith((";", "["))}


def problems_of_configurations():
    """The daemons speak to their tunnel, whose configuration is the shipped one with the names of this cluster."""
    folder = ROOT / "deploy/cluster"
    for file in folder.glob("*.yaml"):
        found = re.findall(r"(?:zookeeper://|zk.servers: \[\")([^\"]*)", file.read_text(encoding="utf-8"))
        if found != ["127.0.0.1:2181"]:
            yield f"{file.name} has the registry {found}, not its tunnel"
    expected = directives(ROOT / "deploy/systemd/registry-tunnel.conf") - {"connect = zk1:2281", "checkHost = zk1"}
    expected = {line.replace("/etc/iotcloud/lab1", "/run/secrets/host").replace("/etc/iotcloud", "/run/secrets") for line in expected}
    expected |= {"connect = registry-tls:2281", "checkHost = registry-tls", "delay = yes"}
    if directives(folder / "registry-tunnel.conf") != expected:
        yield f"registry-tunnel.conf differs from the shipped one: {directives(folder / 'registry-tunnel.conf') ^ expected}"


def problems_of_service(name, service, services, secrets):
    for key in FORBIDDEN:
        if key in service:
            yield f"has {key}"
    if service.get("network_mode", "none") != "none":
        yield f"has network_mode {service['network_mode']}"
    if service.get("cap_drop") != ["ALL"] or "no-new-privileges:true" not in service.get("security_opt", []):
        yield "keeps capabilities, or may gain privileges"
    for key in ("mem_limit", "cpus", "pids_limit"):
        if not service.get(key):
            yield f"has no {key}"
    if service.get("restart") != ("no" if name in RUN_ONCE else "unless-stopped"):
        yield f"has the restart policy {service.get('restart')}"
    if name in SERVICES and not {"test", "interval", "timeout", "retries"} <= set(service.get("healthcheck", {})):
        yield "has no whole health check"
    for other, how in service.get("depends_on", {}).items():
        if how != {"condition": "service_healthy"} or "healthcheck" not in services.get(other, {}):
            yield f"does not wait until {other} is healthy"
    if name in SERVICES - {"zookeeper", "rabbitmq", "kafka"} and not service.get("depends_on"):
        yield "waits for nobody"
    for port in service.get("ports", []):
        if not re.fullmatch(r"127\.0\.0\.1:\$\{[A-Z0-9_]+:-\d+\}:\d+", port):
            yield f"publishes {port}: not on loopback, or not to be chosen"
    for secret in service.get("secrets", []):
        if (secret if isinstance(secret, str) else secret["source"]) not in secrets:
            yield f"has an unknown secret {secret}"
    for key, value in service.get("environment", {}).items():
        if SECRET_WORD.search(key) and not str(value).startswith("/run/secrets/"):
            yield f"has a secret in its environment: {key}"
    for volume in service.get("volumes", []):
        if "docker.sock" in volume:
            yield "reaches the Docker daemon"


def check_that_it_finds(file):
    """The checker finds every broken promise."""
    breaks = {
        "zookeeper has no cpus": lambda services: services["zookeeper"].pop("cpus"),
        "rabbitmq has no whole health check": lambda services: services["rabbitmq"].pop("healthcheck"),
        "kafka has no mem_limit": lambda services: services["kafka"].pop("mem_limit"),
        "master-1 has the restart policy no": lambda services: services["master-1"].update(restart="no"),
        "master-2 has network_mode host": lambda services: services["master-2"].update(network_mode="host"),
        "gateway-1 has privileged": lambda services: services["gateway-1"].update(privileged=True),
        "gateway-2 keeps capabilities": lambda services: services["gateway-2"].pop("cap_drop"),
        "topology-1 waits for nobody": lambda services: services["topology-1"].pop("depends_on"),
        "topology-2 publishes": lambda services: services["topology-2"].update(ports=["9406:9406"]),
        "rabbitmq has a secret in its environment":
            lambda services: services["rabbitmq"].update(environment={"RABBITMQ_DEFAULT_PASS": "guest"}),
        "gateway-1 shares the secret master-1.key with master-1":
            lambda services: services["gateway-1"]["secrets"].append("master-1.key"),
        "master-1 is on the networks": lambda services: services["master-1"].update(networks=["default", "registry"]),
        "gateway-1 has no tunnel": lambda services: services["gateway-1"]["command"].pop(0),
        "topology-1 has no certificate": lambda services: services["topology-1"]["secrets"].remove("ca.pem"),
        "bench has an unknown secret": lambda services: services["bench"].update(secrets=["nobody's"]),
    }
    for expected, break_it in breaks.items():
        broken = copy.deepcopy(file)
        break_it(broken["services"])
        found = problems_of(broken)
        if not any(problem.startswith(expected) for problem in found):
            sys.exit(f"nobody noticed: {expected}; found: {found}")


def main():
    text = (ROOT / "docker-compose.yml").read_text(encoding="utf-8")
    file = yaml.safe_load(text)
    found = [*problems_of(file), *problems_of_configurations()]
    if re.search(r"://[^/\s\"]*:[^/\s\"]*@", text):
        found.append("a URL has a password in it")
    if found:
        sys.exit("docker-compose.yml: " + "; ".join(found))
    check_that_it_finds(file)
    print(f"{len(file['services'])} services keep the promises")


if __name__ == "__main__":
    main()
