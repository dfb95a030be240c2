#!/usr/bin/python3
"""A worker whose pages other machines reach, by TLS and a token only: a viewer sees it through the master, and Prometheus'
way of asking reads it.

usage: far_worker_test.py BUILD_DIR
"""

import json
import shutil
import ssl
import subprocess
import sys
import urllib.error
import urllib.request
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "servers"))

from guarded_cluster import HOST, GuardedCluster  # noqa: E402
from private_cluster import StartError, echo_topology, require, wait_for  # noqa: E402

OPEN = 'metrics: {address: "0.0.0.0:0"}'


class SeenFromAfar(GuardedCluster):
    """The pages of workers ask for certificates and tokens, too."""

    of_api = 'worker_token_file: "{out}/master.token"'

    def make_secrets(self):
        super().make_secrets()
        self.token("master", "pages", "--role", "viewer", "--certificate", self.certs / "lab1.pem")
        self.token("prometheus", "pages", "--role", "viewer")

    def scrape(self, address, token=None, certificate="operator"):
        """As Prometheus does: status and text."""
        context = ssl.create_default_context(cafile=self.certs / "ca.pem")
        if certificate:
            context.load_cert_chain(self.certs / f"{certificate}.pem", self.certs / f"{certificate}.key")
        request = urllib.request.Request(f"https://{address}/metrics")
        if token:
            request.add_header("Authorization", f"Bearer {(self.out / token).read_text().strip()}")
        try:
            with urllib.request.urlopen(request, context=context, timeout=60) as answer:
                return answer.status, answer.read().decode()
        except urllib.error.HTTPError as error:
            return error.code, error.read().decode()


def check_refused_without_guard(cluster):
    for guard, missing in (("", "TLS and tokens"), (cluster.guarded(HOST, "pages").split(", tokens")[0], "tokens"),
                           (f'tokens: "{cluster.out}/pages"', "TLS")):
        file = cluster.out / "open.yaml"
        pages = OPEN.replace("}", f", {guard}}}") if guard else OPEN
        servers = cluster.zookeeper.removeprefix("zookeeper://")
        file.write_text(echo_topology(more=pages).replace("{zookeeper}", servers))
        done = subprocess.run([cluster.bin / "iotcloud-topology", "--config", file], capture_output=True, text=True, timeout=60)
        require(done.returncode != 0 and f"without {missing} anybody there could read the pages" in done.stderr, done)
    print("a worker at 0.0.0.0 does not start without TLS and tokens")


def check_seen_by_a_viewer(cluster):
    def asked(*words):
        done = cluster.run_as("vera", "topology", *words)
        require(done.returncode == 0, done)
        for secret in ("master", "prometheus", "anna"):
            require((cluster.out / f"{secret}.token").read_text().strip() not in done.stdout, f"{words} tell {secret}'s token")
        return json.loads(done.stdout)

    worker, = asked("show", "echo", "-o", "json")["workers"]
    require(worker["tls"] and worker["http"].startswith(f"{HOST}:"), worker)
    wait_for("a viewer sees 100 messages", lambda: {
        one["component"]: one["sum"]["executed"] for one in asked("metrics", "echo", "-o", "json")["components"]}["send"] >= 100)
    sample = asked("tap", "echo", "receive", "--count", "1", "-o", "json")
    require(sample["source"] == "receive" and sample["fields"]["data"]["bytes"] > 0, sample)
    done = cluster.run_as("vera", "topology", "deactivate", "echo")
    require(done.returncode == 1 and "takes operator" in done.stderr, done)
    done = cluster.run_as("prometheus", "topology", "show", "echo")  # a token for pages only
    require(done.returncode != 0 and "nobody's token" in done.stderr, done)
    print(f"a viewer sees the worker at {worker['http']} through the master")
    return worker["http"]


def check_scraped(cluster, pages):
    status, text = cluster.scrape(pages, "prometheus.token")
    require(status == 200 and "iotcloud_task_executed_total" in text, (status, text[:500]))
    for token, certificate in ((None, "operator"), ("vera.token", "operator"), ("master.token", "operator")):
        status, text = cluster.scrape(pages, token, certificate)  # the master's counts with its own certificate only
        require(status == 401 and "iotcloud_" not in text, (token, status, text[:500]))
    try:
        answer = cluster.scrape(pages, "prometheus.token", certificate=None)
    except OSError:
        answer = None
    require(answer is None, f"the pages are shown without a certificate: {answer}")
    print("Prometheus reads its metrics with a certificate and a token file, and nobody else does")


def main():
    build = Path(sys.argv[1]).resolve()
    work = build / "far-worker-test"
    shutil.rmtree(work, ignore_errors=True)
    with SeenFromAfar(work, build / "bin", build / "plugins") as cluster:
        cluster.make_secrets()
        cluster.start(gateways=1)
        check_refused_without_guard(cluster)
        guarded = OPEN.replace("}", f", {cluster.guarded(HOST, 'pages')}}}")
        cluster.topology("worker", echo_topology(more=guarded))
        cluster.wait_until_ready()
        cluster.deploy("loadgen.so", "gateway-1", {"rate": 100})
        pages = check_seen_by_a_viewer(cluster)
        check_scraped(cluster, pages)
        cluster.undeploy_all()
        cluster.require_alive()
    print("a worker is seen from elsewhere by those who may, and by nobody else")


if __name__ == "__main__":
    try:
        main()
    except StartError as error:
        sys.exit(str(error))
