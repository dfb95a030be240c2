"""A private system whose gateway, `house`, makes instances of what announces itself at a private Mosquitto. No master runs."""

import json

from private_cluster import PrivateCluster, free_port


class House(PrivateCluster):
    def begin(self, rules, *, zookeeper=(), mosquitto=(), gateway=()):
        """Starts the servers and the gateway, with further options of theirs. `rules`: YAML that provisions, with the URL of
        Mosquitto written as {mqtt}."""
        self.zookeeper = self.server("zookeeper", *zookeeper)
        self.rabbitmq = self.server("rabbitmq")
        self.mqtt = self.server("mosquitto", *mosquitto)
        self.mqtt_port = int(self.mqtt.rsplit(":", 1)[1])
        self.state = self.out / "state"
        file = self.out / "rules.yaml"
        file.write_text(rules.replace("{mqtt}", self.mqtt))
        self.daemon("iotcloud-gateway", "gateway", f"""
id: house
registry: "{self.zookeeper}"
thrift: {{host: 127.0.0.1, port: {free_port()}}}
plugins: "{self.plugins}"
state: "{self.state}"
provisioning: "{file}"
brokers:
  rabbitmq: {{type: rabbitmq, urls: ["{self.rabbitmq}"]}}
""", options=gateway)

    def instances(self, driver):
        """The last change of each instance of the driver that is not undeployed, from the gateway's history: its `state`, and
        `time_ms`, since when."""
        file, last = self.state / "history.jsonl", {}
        for line in file.read_text().splitlines() if file.exists() else []:
            try:
                change = json.loads(line)
            except ValueError:
                continue  # it is just being written
            last[change["instance"]] = change
        return [change for change in last.values() if change["driver"] == driver and change["state"] != "undeployed"]

    def runs(self, driver, count):
        """Whether the driver has so many instances, and all are active."""
        return [change["state"] for change in self.instances(driver)] == ["active"] * count
