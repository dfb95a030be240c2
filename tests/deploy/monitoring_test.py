#!/usr/bin/python3
"""Prometheus' rules and Grafana's dashboard, deploy/prometheus and deploy/grafana.

usage: monitoring_test.py DEPLOY_FOLDER                  the rules are good, each alert fires and stays silent where it should
                                                         (alerts_test.yml, promtool), and all queries can be parsed
       monitoring_test.py DEPLOY_FOLDER --live BUILD_DIR a private Prometheus reads a private system: each query of the
                                                         dashboard returns data, and what an alert is for is seen in it
"""

import argparse
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import urllib.error
import urllib.parse
import urllib.request
from pathlib import Path

import yaml

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "servers"))

from private_cluster import PrivateCluster, StartError, Unavailable, echo_topology, require, wait_for  # noqa: E402
from private_server import free_ports  # noqa: E402

DAYS = 5  # that the certificate and the token of the test have left
VARIABLES = {"$__rate_interval": "10s", "$job": "iotcloud", "$topology": ".*"}
DATASOURCE = {"type": "prometheus", "uid": "${datasource}"}


def panels_of(dashboard):
    """(title, query) of all panels."""
    for panel in dashboard["panels"]:
        for target in panel.get("targets", []):
            require(panel["datasource"] == target["datasource"] == DATASOURCE, f"{panel['title']} has a data source of its own")
            yield panel["title"], target["expr"]


def filled(query):
    for name, value in VARIABLES.items():
        query = query.replace(name, value)
    require("$" not in query, f"the test knows no variable of {query}")
    return query


def promtool(folder, *words):
    done = subprocess.run(["promtool", *words], cwd=folder, capture_output=True, text=True)
    require(done.returncode == 0, f"promtool {' '.join(words)}: {done.stdout}{done.stderr}")


def check_files(rules_file, dashboard):
    rules = [rule for group in yaml.safe_load(rules_file.read_text())["groups"] for rule in group["rules"]]
    alerts = {rule["alert"] for rule in rules if "alert" in rule}
    tested = yaml.safe_load((HERE / "alerts_test.yml").read_text())["tests"]
    cases = [case for test in tested for case in test["alert_rule_test"]]
    for kind, has in (("fires", True), ("is silent", False)):
        missing = alerts - {case["alertname"] for case in cases if bool(case["exp_alerts"]) == has}
        require(not missing, f"no test in which it {kind}: {', '.join(sorted(missing))}")
    with tempfile.TemporaryDirectory(prefix="iotcloud-rules-") as folder:
        shutil.copy(rules_file, folder)
        shutil.copy(HERE / "alerts_test.yml", folder)
        queries = [{"record": f"query:{number}", "expr": filled(query)} for number, (_, query) in enumerate(panels_of(dashboard))]
        (Path(folder) / "queries.yml").write_text(yaml.safe_dump({"groups": [{"name": "queries", "rules": queries}]}))
        promtool(folder, "check", "rules", rules_file.name, "queries.yml")
        promtool(folder, "test", "rules", "alerts_test.yml")
    ids = [panel["id"] for panel in dashboard["panels"]]
    require(len(ids) == len(set(ids)), "two panels have one id")
    print(f"{len(alerts)} alerts fire and are silent where they should; {len(queries)} queries can be parsed")


class Prometheus:
    """A private one, which asks each second."""

    def __init__(self, cluster, rules_file, targets, guarded, token_file):
        """`targets`, `guarded`: addresses of pages, those that want no token, and those that want the one in this file."""
        rules = yaml.safe_load(rules_file.read_text())
        for group in rules["groups"]:
            for rule in group["rules"]:
                rule.pop("for", None)  # how long a fault lasts is what promtool's tests are about
        folder = cluster.out / "prometheus"
        folder.mkdir(parents=True)
        (folder / "rules.yml").write_text(yaml.safe_dump(rules))
        same_job = [{"target_label": "job", "replacement": "iotcloud"}]
        (folder / "prometheus.yml").write_text(yaml.safe_dump({
            "global": {"scrape_interval": "1s", "evaluation_interval": "1s"}, "rule_files": ["rules.yml"],
            "scrape_configs": [
                {"job_name": "open", "static_configs": [{"targets": targets}], "relabel_configs": same_job},
                {"job_name": "guarded", "static_configs": [{"targets": guarded}], "relabel_configs": same_job,
                 "authorization": {"credentials_file": str(token_file)}}]}))
        self.address = f"127.0.0.1:{free_ports(1)[0]}"
        cluster.spawn("prometheus", ["prometheus", f"--config.file={folder / 'prometheus.yml'}", f"--web.listen-address={self.address}",
                                     f"--storage.tsdb.path={folder / 'data'}"])

    def ask(self, path, **parameters):
        url = f"http://{self.address}/api/v1/{path}?{urllib.parse.urlencode(parameters)}"
        try:
            answer = json.load(urllib.request.urlopen(url, timeout=60))
        except urllib.error.HTTPError as error:
            raise StartError(f"{parameters}: {error.read().decode()}") from error
        return answer["data"]

    def values(self, query):
        """The values of what a query finds now."""
        return [float(found["value"][1]) for found in self.ask("query", query=filled(query))["result"]]

    def firing(self):
        return {alert["labels"]["alertname"] for alert in self.ask("alerts")["alerts"] if alert["state"] == "firing"}


class Live:
    def __init__(self, cluster, prometheus, dashboard):
        self.cluster, self.prometheus = cluster, prometheus
        self.queries = list(panels_of(dashboard))

    def without_data(self):
        return [f"{title}: {query}" for title, query in self.queries if not self.prometheus.values(query)]

    def wait_for_data(self):
        try:
            wait_for("each query returns data", lambda: not self.without_data())
        except SystemExit:
            print("\n".join(self.without_data()))
            raise

    def shows(self, title, least):
        """Whether a panel shows a value of at least so much."""
        return any(value >= least for of, query in self.queries if of == title for value in self.prometheus.values(query))

    def check_fault(self, alert, panels, cause, mend=lambda: None, stays=False):
        """What `cause` does makes the alert fire, and these panels show 1 or more. After `mend` all panels have data, and the alert
        is silent, unless it `stays` for its ten minutes."""
        # A driver host that was started again, say, has no broker for a moment.
        wait_for(f"{alert} is silent, and so are {panels}",
                 lambda: alert not in self.prometheus.firing() and not any(self.shows(title, 1) for title in panels))
        cause()
        wait_for(f"{alert} fires", lambda: alert in self.prometheus.firing())
        for title in panels:
            wait_for(f"the panel {title} shows it", lambda title=title: self.shows(title, 1))
        mend()
        if not stays:
            wait_for(f"{alert} is silent again", lambda: alert not in self.prometheus.firing())
        self.wait_for_data()
        print(f"{alert}: fires, and is seen in {', '.join(panels)}")

    def run(self):
        self.wait_for_data()
        for title, least in (("Daemons", 4), ("Messages of drivers", 1), ("Commands to drivers", 1), ("Tuples executed", 1),
                             ("Spools", 1), ("Sent by bolts", 1), ("Days left", DAYS - 1), ("Memory of driver hosts", 1 << 20)):
            wait_for(f"{title} shows {least} or more", lambda title=title, least=least: self.shows(title, least))
        expected = {"IotcloudCertificateEnds", "IotcloudTokenEnds"}
        try:
            wait_for(f"these alerts fire, and no others: {expected}", lambda: self.prometheus.firing() == expected)
        except SystemExit:
            print(self.prometheus.ask("alerts")["alerts"])
            raise
        print(f"{len(self.queries)} queries return data, and only what ends in {DAYS} days makes alerts")

        cluster = self.cluster
        self.check_fault("IotcloudDriverHostFails", ["Failures of driver hosts"], self.kill_host, stays=True)
        self.check_fault("IotcloudBrokerAway", ["Brokers away", "Brokers of drivers", "Brokers of topologies"],
                         lambda: cluster.tell("rabbitmq", "kill"), lambda: cluster.tell("rabbitmq", "start"))
        self.check_fault("IotcloudRegistryAway", ["Without a registry"], lambda: cluster.tell("zookeeper", "kill"),
                         lambda: cluster.tell("zookeeper", "start"))
        self.check_fault("IotcloudDaemonDown", ["Daemons down"], lambda: cluster.end("master", signal.SIGKILL),
                         lambda: cluster.again("master"))

    def kill_host(self):
        os.kill(self.cluster.hosts_of("gateway-1")[0], signal.SIGKILL)


def make_certificate(folder):
    """A certificate that ends in DAYS days."""
    file = folder / "short.pem"
    subprocess.run(["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-subj", "/CN=short",
                    "-days", str(DAYS), "-keyout", folder / "short.key", "-out", file], check=True, capture_output=True)
    return file


def check_live(rules_file, dashboard, build):
    work = build / "monitoring-test"
    shutil.rmtree(work, ignore_errors=True)
    pages = {name: f"127.0.0.1:{port}" for name, port in zip(("master", "gateway", "worker", "pool"), free_ports(4))}
    with PrivateCluster(work, build / "bin", build / "plugins") as cluster:
        certificate, tokens = make_certificate(work), work / "tokens"
        token = subprocess.run([cluster.bin / "iotcloud", "token", "add", "prometheus", "--role", "viewer", "--days", str(DAYS), "--file",
                                tokens], check=True, capture_output=True, text=True).stdout
        (work / "prometheus.token").write_text(re.search(r"\S{20,}", token)[0])
        cluster.start(gateways=1, more=f'metrics: {{address: "{pages["gateway"]}", certificates: ["{certificate}"]}}',
                      of_masters=f'metrics: {{address: "{pages["master"]}"}}')
        cluster.topology("worker", echo_topology(more=f'metrics: {{address: "{pages["worker"]}"}}'))
        (work / "pool.yaml").write_text(f"""
id: pool-1
registry: "{cluster.zookeeper}"
state: "{work / 'state' / 'pool'}"
metrics: {{address: "{pages["pool"]}", tokens: "{tokens}"}}
""")
        cluster.spawn("pool", [cluster.bin / "iotcloud-topology", "--pool", "--config", work / "pool.yaml"])
        prometheus = Prometheus(cluster, rules_file, [pages["master"], pages["gateway"], pages["worker"]], [pages["pool"]],
                                work / "prometheus.token")
        cluster.wait_until_ready()
        cluster.deploy("loadgen.so", "gateway-1", {"rate": 20, "channel.data.when_full": "spool"})
        Live(cluster, prometheus, dashboard).run()
        cluster.undeploy_all()
        cluster.require_alive()


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("deploy", type=Path)
    parser.add_argument("--live", type=Path, metavar="BUILD_DIR")
    given = parser.parse_args()
    rules_file = given.deploy / "prometheus/iotcloud.yml"
    dashboard = json.loads((given.deploy / "grafana/iotcloud.json").read_text())
    try:
        if given.live:
            check_live(rules_file, dashboard, given.live.resolve())
        else:
            check_files(rules_file, dashboard)
    except Unavailable as reason:
        print(reason)
        sys.exit(77)
    except StartError as error:
        sys.exit(str(error))


if __name__ == "__main__":
    main()
