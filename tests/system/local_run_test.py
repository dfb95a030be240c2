#!/usr/bin/python3
"""`iotcloud run`: a topology and its drivers in one process, without any server.

usage: local_run_test.py BUILD_DIR CONFIG_FOLDER [--servers | --limit SECONDS]
       --servers: with a real broker and registry; --limit: the most from the start to the first average of 1 s
"""
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
import urllib.request
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "servers"))

from private_cluster import Children, wait_for  # noqa: E402

BUILD, CONFIG = Path(sys.argv[1]), Path(sys.argv[2])
AVERAGE = r"mean: took [1-9]\d*/s, emitted [1-9]\d*/s.*mean"

MEAN = """\
zk.servers: ["127.0.0.1:2181"]
topology.name: "mean"
topology.library: "libtopology_test_mean.so"
spouts:
  in: {broker: "rabbitmq", driver: "loadgen", channel: "data", fields: ["data", "driverID", "time"]}
bolts:
  mean: {class: "mean.Size", conf: {WINDOW: 1s}, inputs: [{from: in, grouping: fields, fields: [driverID]}]}
"""


class Run:
    """A run whose lines, errors too, are read as they come."""

    def __init__(self, *words, plugin="plugins/loadgen.so", stop_limit="60"):
        self.began = time.monotonic()
        self.said = ""
        self.process = subprocess.Popen([BUILD / "bin/iotcloud", "run", *words, "--stop-limit", stop_limit, "--plugin", BUILD / plugin],
                                        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)

    def wait_for(self, pattern):
        """Returns the line, and the seconds since the start."""
        for line in self.process.stdout:
            self.said += line
            if re.search(pattern, line):
                return line.strip(), time.monotonic() - self.began
        sys.exit(f"it ended without {pattern!r}, status {self.process.wait()}:\n{self.said}")

    def end(self, status=0):
        self.process.send_signal(signal.SIGINT)
        rest, _ = self.process.communicate(timeout=120)
        if self.process.returncode != status:
            sys.exit(f"status {self.process.returncode}:\n{self.said}{rest}")


def address_of(url):
    return re.search(r"127\.0\.0\.1:\d+", url)[0]


def the_files_of_a_cluster_run_as_they_stand():
    # The file of the README's echo topology names ZooKeeper and RabbitMQ, which are not there.
    echo = Run(CONFIG / "topology.yaml", "-n", "2", "--property", "rate=50")
    echo.wait_for(r"data_receive: emitted [1-9]\d*/s")
    if "2 loadgen active" not in echo.said:
        sys.exit("the instances are not shown:\n" + echo.said)
    echo.end()


class View:
    """The console of a run."""

    def __init__(self, url):
        self.url = url

    def call(self, name, **given):
        request = urllib.request.Request(f"{self.url}api/call/{name}", data=json.dumps(given).encode(),
                                         headers={"Content-Type": "application/json", "Origin": self.url.rstrip("/")})
        with urllib.request.urlopen(request, timeout=60) as answer:
            return json.load(answer)

    def first(self):
        """The first of each kind of event that an open page gets, when there is a worker."""
        seen, event = {}, ""
        with urllib.request.urlopen(f"{self.url}api/live?rows=1", timeout=60) as stream:
            for line in stream:
                word, _, rest = line.decode().strip().partition(": ")
                if word == "event":
                    event = rest
                elif word == "data":
                    seen[event] = json.loads(rest)
                if seen.get("rows", {}).get("set") and seen.get("state", {}).get("topologies"):
                    return seen
        sys.exit("the stream has ended")


def the_page_has_the_log_the_way_of_messages_and_what_is_read():
    echo = Run(CONFIG / "topology.yaml", "--property", "rate=50", "--view", "127.0.0.1:0", "--log-level", "info")
    view = View(echo.wait_for(r"console: http")[0].removeprefix("console: "))
    echo.wait_for(r"data_receive: emitted [1-9]\d*/s")
    seen = view.first()
    row, topology = seen["rows"]["set"][0], seen["state"]["topologies"][0]
    of_instance = {"gateway": row["gateway"], "instance": row["instance"]}
    of_worker = {"topology": topology["name"], "worker": topology["workers"][0]["name"]}
    log = view.call("log", position="", **of_instance)
    if row["instance"] not in log["text"] or view.call("log", position=log["position"], **of_instance)["text"] == log["text"]:
        sys.exit(f"the log is not that of the process: {log}")
    units = view.call("worker", target="/units", **of_worker)
    if not any(spout["units"] for spout in units["spouts"]):
        sys.exit(f"nobody reads anything: {units}")
    trace, sent, back = {}, {}, {}

    def came_back():
        page = view.call("worker", target=f"/trace?id=a&driver={row['instance']}&every_ms=100", **of_worker)
        trace.update({way["time_ms"]: (page["clock"], way) for way in page["ways"] if way["outcome"]})
        for channel, to in (("data", sent), ("echo", back)):
            look = view.call("look", channel=channel, look="a", most=64, bytes=0, every_ms=100, **of_instance)
            to.update({message["time_ms"]: (look["clock"], message) for message in look["messages"] if message.get("end_us")})
        return set(trace) & set(sent) & set(back)

    wait_for("a message is followed there and back", came_back)
    time_ms = came_back().pop()
    (clock, way), (of_host, out), (_, home) = trace[time_ms], sent[time_ms], back[time_ms]
    times = [out["begin_us"], way["came_us"], way["taken_us"], way["steps"][0]["begin_us"], home["came_us"], home["begin_us"], home["end_us"]]
    if clock != of_host or way["outcome"] != "acked" or out["fate"] != "confirmed" or any(a > b + 1 for a, b in zip(times, times[1:])):
        sys.exit(f"the way is not one: {clock} {of_host} {times}\n{way}\n{out}\n{home}")
    echo.end()


def the_first_average_is_there_soon_and_changes_are_taken_up():
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "mean.yaml"
        file.write_text(MEAN.replace("WINDOW", "window.length"))
        mean = Run(file, "--property", "rate=50")
        line, seconds = mean.wait_for(AVERAGE)
        print(f"from the start to the first average of a window of 1 s: {seconds:.2f} s: {line}")
        file.write_text(MEAN.replace("WINDOW", "window.lenght"))
        mean.wait_for("mean.yaml changed: all starts anew")
        mean.wait_for("window.lenght")
        mean.wait_for("waiting for a file to change")
        file.write_text(MEAN.replace("WINDOW: 1s", "window.length: 500ms"))
        mean.wait_for(AVERAGE)
        mean.end()


def a_library_that_changes_is_loaded_anew():
    with tempfile.TemporaryDirectory() as folder:
        file, library = Path(folder) / "mean.yaml", Path(folder) / "libtopology_test_mean.so"
        file.write_text(MEAN.replace("WINDOW", "window.length"))
        shutil.copy(BUILD / "plugins" / library.name, library)
        mean = Run(file, "--property", "rate=50")
        mean.wait_for(AVERAGE)
        shutil.copy(library, library.with_suffix(".new"))  # as a linker does: the new file takes the old one's name
        os.replace(library.with_suffix(".new"), library)
        mean.wait_for("libtopology_test_mean.so changed: all starts anew")
        mean.wait_for(AVERAGE)
        mean.end()


def a_plugin_that_changes_is_loaded_anew():
    with tempfile.TemporaryDirectory() as folder:
        plugin = Path(folder) / "loadgen.so"
        shutil.copy(BUILD / "plugins" / plugin.name, plugin)
        echo = Run(CONFIG / "topology.yaml", "--property", "rate=50", plugin=plugin)
        echo.wait_for(r"data_receive: emitted [1-9]\d*/s")
        shutil.copy(plugin, plugin.with_suffix(".new"))
        os.replace(plugin.with_suffix(".new"), plugin)
        echo.wait_for("loadgen.so changed: all starts anew")
        echo.wait_for(r"data_receive: emitted [1-9]\d*/s")
        echo.end()


def a_real_broker_and_registry_take_the_place_of_the_embedded_ones():
    with tempfile.TemporaryDirectory() as folder, Children(folder) as servers:
        broker, registry = servers.server("rabbitmq"), servers.server("zookeeper")
        file = Path(folder) / "mean.yaml"
        file.write_text(MEAN.replace("WINDOW", "window.length"))
        mean = Run(file, "--property", "rate=50", "--broker", broker, "--registry", registry, "--log-level", "info")
        mean.wait_for(AVERAGE)
        for url in (broker, registry):
            if not re.search(rf"connected to .*{re.escape(address_of(url))}", mean.said):
                sys.exit(f"nothing is connected to {address_of(url)}:\n{mean.said}")
        mean.end()


def nodes_of(registry):
    """How many nodes this ZooKeeper has, by its own word."""
    host, port = address_of(registry).split(":")
    with socket.create_connection((host, int(port)), timeout=60) as connection:
        connection.sendall(b"srvr")
        answer = connection.makefile().read()
    return int(re.search(r"Node count: (\d+)", answer)[1])


def a_run_leaves_nothing_in_a_real_registry():
    with tempfile.TemporaryDirectory() as folder, Children(folder) as servers:
        registry = servers.server("zookeeper")
        before = nodes_of(registry)
        file = Path(folder) / "mean.yaml"
        file.write_text(MEAN.replace("WINDOW", "window.length"))
        mean = Run(file, "-n", "2", "--property", "rate=50", "--registry", registry)
        mean.wait_for(AVERAGE)
        if nodes_of(registry) <= before:
            sys.exit("the run has no record in the registry")
        file.write_text(MEAN.replace("WINDOW: 1s", "window.length: 500ms"))
        mean.wait_for("mean.yaml changed: all starts anew")
        mean.said = ""
        mean.wait_for(AVERAGE)
        mean.end()
        shown = set(re.findall(r"^\d+ loadgen.*", mean.said, re.MULTILINE))
        if shown != {"2 loadgen active"}:
            sys.exit(f"after it started anew there are other instances than two: {shown}")
        # A run that ends does not wait for the registry's answer for long; then its session ends a little later.
        wait_for("no node is left in the registry", lambda: nodes_of(registry) == before)


def the_first_average_is_there_within(limit):
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "mean.yaml"
        file.write_text(MEAN.replace("WINDOW", "window.length"))
        times = []
        for _ in range(5):
            mean = Run(file, "--property", "rate=50")
            times.append(mean.wait_for(AVERAGE)[1])
            mean.end()
    times.sort()
    print(f"from the start to the first average of a window of 1 s: {times[2]:.2f} s, median of {len(times)} "
          f"({times[0]:.2f} to {times[-1]:.2f}); limit {limit:.2f} s")
    if times[2] > limit:
        sys.exit("wrong: that is too long")


def a_property_that_the_driver_does_not_have_ends_the_run():
    wrong = Run(CONFIG / "topology.yaml", "--property", "rat=50", "--seconds", "1")
    wrong.wait_for(r"iotcloud-run: .*loadgen.so: .*rat")
    if wrong.process.wait(timeout=120) != 2:
        sys.exit(f"status {wrong.process.returncode}:\n{wrong.said}")


def a_driver_that_no_plugin_is_is_named():
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "echo.yaml"
        file.write_text((CONFIG / "topology.yaml").read_text().replace('driver: "loadgen"', 'driver: "laodgen"', 1))
        echo = Run(file)
        echo.wait_for(r'data_receive: no plugin of this run is the driver "laodgen"; did you mean "loadgen"\?')
        echo.end()
        if "echo_send: no plugin" in echo.said:
            sys.exit("a driver that is there is called missing:\n" + echo.said)


def a_start_that_waits_for_a_driver_ends_with_a_signal():
    hanging = Run(CONFIG / "topology.yaml", plugin="tests/system/hanging_driver.so", stop_limit="10")
    hanging.wait_for("the driver hangs")
    hanging.wait_for("it waits for the registry, and then until all drivers are open")
    hanging.end()


def main():
    if sys.argv[3:4] == ["--limit"]:
        the_first_average_is_there_within(float(sys.argv[4]))
        return
    if sys.argv[3:] == ["--servers"]:
        a_real_broker_and_registry_take_the_place_of_the_embedded_ones()
        a_run_leaves_nothing_in_a_real_registry()
        return
    the_files_of_a_cluster_run_as_they_stand()
    the_page_has_the_log_the_way_of_messages_and_what_is_read()
    the_first_average_is_there_soon_and_changes_are_taken_up()
    a_library_that_changes_is_loaded_anew()
    a_plugin_that_changes_is_loaded_anew()
    a_property_that_the_driver_does_not_have_ends_the_run()
    a_driver_that_no_plugin_is_is_named()
    a_start_that_waits_for_a_driver_ends_with_a_signal()


if __name__ == "__main__":
    main()
