#!/usr/bin/python3
"""deploy/cluster/prometheus.yml reads the pages of all daemons of docker-compose.yml: it names each of them, at the address of
its configuration, and files that its container gets. A daemon of each kind, with its shipped configuration and with secrets as
`./dev cluster up` makes them, shows its metrics to a reader with those files, and nothing to others. Debian's Prometheus, with
that file, reads them, too.

usage: prometheus_test.py BIN_DIR
"""

import http.client
import os
import re
import socket
import ssl
import subprocess
import sys
import tempfile
from pathlib import Path

import yaml

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "deploy/cluster"), str(ROOT / "tests/servers")]

import cluster  # noqa: E402  (its folder is known now)
import cluster_secrets  # noqa: E402
import private_prometheus  # noqa: E402
from private_cluster import PrivateCluster, Unavailable, free_port, require, wait_for  # noqa: E402

CONFIGURATIONS = ROOT / "deploy/cluster"
SAMPLE = CONFIGURATIONS / "prometheus.yml"
SKIPPED = 77
METRIC = re.compile(r"^iotcloud_\w+(\{.*\})? \S+$", re.M)


def configuration_of(service):
    return CONFIGURATIONS / ("topology.yaml" if service in cluster.WORKERS else f"{service}.yaml")


def page_of(service):
    """The address at which others reach the pages of a service, by its configuration."""
    metrics = yaml.safe_load(configuration_of(service).read_text(encoding="utf-8"))["metrics"]
    host, port = metrics["address"].split(":")
    require(host == "0.0.0.0" and metrics["tls"] and metrics["tokens"], f"{service} shows its pages as {metrics}")
    return f"{service}:{port}"


def check_sample(sample):
    require(sample.keys() == {"global", "scrape_configs"}, f"prometheus.yml has {sorted(sample)}")
    job, = sample["scrape_configs"]
    require(job.keys() == {"job_name", "scheme", "tls_config", "authorization", "static_configs"}, f"its job has {sorted(job)}")
    targets = [target for group in job["static_configs"] for target in group["targets"]]
    daemons = cluster.MASTERS + cluster.GATEWAYS + cluster.WORKERS + cluster.POOLS
    require(sorted(targets) == sorted(map(page_of, daemons)), f"prometheus.yml reads {targets}")
    require(job["scheme"] == "https" and job["authorization"]["type"] == "Bearer", "prometheus.yml reads without TLS or token")
    require(not job["tls_config"].get("insecure_skip_verify"), "prometheus.yml takes any certificate")
    named = {*job["tls_config"].values(), job["authorization"]["credentials_file"]}
    given = {f"/run/secrets/{name}" for name in cluster.FILES["prometheus"]}
    require(named == given, f"prometheus.yml names {sorted(named)}, and its container has {sorted(given)}")
    service = yaml.safe_load((ROOT / "docker-compose.yml").read_text(encoding="utf-8"))["services"]["prometheus"]
    require(f"--config.file=/etc/iotcloud/{SAMPLE.name}" in service["command"], f"the service has another file: {service['command']}")


def start(machine, command, service, secrets):
    """Starts a daemon with its shipped configuration, on ports of this test. Returns that of its pages."""
    port = free_port()
    text = configuration_of(service).read_text(encoding="utf-8")
    state = machine.out / service
    state.mkdir()
    for there, here in {"0.0.0.0:" + page_of(service).split(":")[1]: f"0.0.0.0:{port}", "port: 12904": f"port: {free_port()}",
                        "port: 12905": f"port: {free_port()}", "port: 12906": f"port: {free_port()}",
                        "127.0.0.1:2181": machine.zookeeper.removeprefix("zookeeper://"),
                        "/run/secrets": str(secrets / service), "/usr/lib/iotcloud/plugins": str(machine.plugins),
                        "/var/lib/iotcloud-reports": str(state), "/var/lib/iotcloud": str(state)}.items():
        text = text.replace(there, here)
    file = machine.out / f"{service}.yaml"
    file.write_text(text, encoding="utf-8")
    machine.spawn(service, [str(machine.bin / command[0]), *command[1:], "--config", str(file)])
    return port


def read(secrets, service, port, token_of="prometheus", certificate_of="prometheus"):
    """The answer to GET /metrics: its status and text; a status of 0: none, for lack of trust."""
    own = secrets / certificate_of
    context = ssl.create_default_context(cafile=own / "ca.pem")
    context.load_cert_chain(own / "host.pem", own / "host.key")
    token = (secrets / token_of / ("prometheus.token" if token_of == "prometheus" else "health.token")).read_text(encoding="utf-8")
    try:
        with context.wrap_socket(socket.create_connection(("127.0.0.1", port), timeout=60), server_hostname=service) as stream:
            stream.sendall(f"GET /metrics HTTP/1.1\r\nHost: {service}\r\nConnection: close\r\n"
                           f"Authorization: Bearer {token.strip()}\r\n\r\n".encode())
            answer = http.client.HTTPResponse(stream)
            answer.begin()
            return answer.status, answer.read().decode()
    except OSError as error:
        return 0, str(error)


def is_well(programs, secrets, service, port):
    """What the container's own health check says of its daemon."""
    shipped = yaml.safe_load((ROOT / "docker-compose.yml").read_text(encoding="utf-8"))["services"][service]
    given = {name: value.replace("/run/secrets", str(secrets / service)) for name, value in shipped["environment"].items()}
    program, verb, address = shipped["healthcheck"]["test"][1:]
    done = subprocess.run([programs / program, verb, f"{address.split(':')[0]}:{port}"], env=given, capture_output=True, text=True,
                          timeout=60, check=False)
    return done.returncode == 0


def main():
    programs = Path(sys.argv[1]).resolve()
    check_sample(yaml.safe_load(SAMPLE.read_text(encoding="utf-8")))
    # Below the project's folder, as those of `./dev cluster up` are.
    with tempfile.TemporaryDirectory(dir=programs.parent) as work:
        secrets = Path(work) / "secrets"
        cluster_secrets.make(programs, secrets)
        with PrivateCluster(Path(work) / "out", programs, programs.parent / "plugins") as machine:
            machine.zookeeper = machine.server("zookeeper")
            ports = {}
            for service, command in {"master-1": ["iotcloud-master"], "gateway-1": ["iotcloud-gateway"],
                                     "topology-1": ["iotcloud-topology"], "pool-1": ["iotcloud-topology", "--pool"]}.items():
                port = ports[service] = start(machine, command, service, secrets)
                wait_for(f"{service} answers", lambda service=service, port=port: read(secrets, service, port)[0] == 200)
                wait_for(f"{service} is well", lambda service=service, port=port: is_well(programs, secrets, service, port))
                text = read(secrets, service, port)[1]
                require(METRIC.search(text), f"{service} shows no metrics: {text[:200]}")
                for why, with_these in {"a token that is another daemon's": {"token_of": "gateway-2"},
                                        "a token with another's certificate": {"certificate_of": "gateway-2"}}.items():
                    status, text = read(secrets, service, port, **with_these)
                    require(status == 401, f"{service} answers {status} to {why}: {text[:200]}")
                status, text = read(secrets, "prometheus", port)
                require(status == 0 and "hostname" in text.lower(), f"the certificate of {service} names prometheus, too: {text[:200]}")
                print(f"{service}: its metrics are read as {SAMPLE.name} says, and with nobody else's token or certificate")
            try:
                private_prometheus.check(machine, SAMPLE, secrets, ports)
            except Unavailable as why:
                print(f"SKIPPED: no Prometheus: {why}")
                sys.exit(1 if os.environ.get("CI") == "true" else SKIPPED)


if __name__ == "__main__":
    main()
