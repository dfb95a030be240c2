#!/usr/bin/python3
"""A gateway with rules that provision, as processes: devices announce themselves to Home Assistant at a real Mosquitto, and become
instances in a driver host; a gateway that is killed adopts them; a device that goes away takes its instance with it. No master runs.

usage: provisioning_test.py BUILD_DIR
"""
import json
import signal
import sys
import tempfile
from pathlib import Path

import paho.mqtt.client as mqtt

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "servers"))
from house import House  # noqa: E402
from private_cluster import PATIENT_STOP, require, wait_for  # noqa: E402

RULES = """
finders: {house: {plugin: mqtt_finder.so, properties: {url: "{mqtt}", find: homeassistant}}}
rules:
  devices:
    finder: house
    plugin: mqtt.so
    name: "ha-{id:name}"
    properties: {url: "{mqtt}", subscribe: "{subscribe:topics}"}
    grace: 1s
"""


class Devices(House):
    def connect(self):
        self.hub = mqtt.Client("hub")
        self.hub.connect("127.0.0.1", self.mqtt_port)
        self.hub.loop_start()

    def announce(self, device, there=True):
        text = json.dumps({"stat_t": f"{device}/state", "dev": {"ids": [device]}}) if there else ""
        self.hub.publish(f"homeassistant/sensor/{device}/config", text, qos=1, retain=True).wait_for_publish(60)

    def hosts(self, plugin):
        """Ids of the processes that run this plugin, wherever they are: those of a dead gateway are nobody's children."""
        found = []
        for folder in Path("/proc").glob("[0-9]*"):
            try:
                words = (folder / "cmdline").read_bytes()
            except OSError:
                continue
            if b"iotcloud-driver-host" in words and str(self.state).encode() in words and f"{plugin}.so".encode() in words:
                found.append(int(folder.name))
        return found


def main():
    build = Path(sys.argv[1])
    with tempfile.TemporaryDirectory(prefix="iotcloud-provisioning-") as folder, \
            Devices(Path(folder) / "house", build / "bin", build / "plugins") as house:
        house.begin(RULES, gateway=PATIENT_STOP)
        house.connect()
        wait_for("the finder runs", lambda: house.runs("mqtt_finder", 1))
        for device in ("kitchen", "hall"):
            house.announce(device)
        wait_for("two devices are instances", lambda: house.runs("mqtt", 2))
        before = house.hosts("mqtt")
        require(len(before) == 1, f"one host runs both instances: {before}")
        house.end("gateway", signal.SIGKILL)
        house.announce("hall", there=False)
        house.announce("garden")
        house.again("gateway")
        wait_for("the new device is an instance, and the one that went is none",
                 lambda: house.runs("mqtt", 2) and "garden" in (house.state / "provisioned.jsonl").read_text()
                 and "hall" not in (house.state / "provisioned.jsonl").read_text())
        require(house.hosts("mqtt") == before, "the host of the killed gateway goes on")
        house.hub.disconnect()
        house.require_alive()
    print("devices that announce themselves are instances, also of a gateway that was killed")


if __name__ == "__main__":
    main()
