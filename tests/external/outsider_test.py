#!/usr/bin/python3
"""An outsider's driver and bolts: installs the SDK, builds a project that sees nothing else, runs its tests, deploys and
runs it. It is the project that docs/driver-sdk.md, docs/topology-sdk.md and docs/storm.md print (tests/house compares the two). The
project that docs/glance.md prints is built, too, and so is what `iotcloud new` makes. A driver and a component library with an undefined symbol are not.

usage: outsider_test.py BUILD_DIR   (exit status 0: every reading that was answered was answered rightly)
"""

import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "servers"))

from private_cluster import PrivateCluster  # noqa: E402

ANSWERS = 100
GLANCE = HERE.parent.parent / "docs/glance.md"


def run(*command):
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"{' '.join(map(str, command))}\n{done.stdout}{done.stderr}")


def build(source, folder, prefix, *options):
    run("cmake", "-S", source, "-B", folder, "-G", "Ninja", f"-DCMAKE_PREFIX_PATH={prefix}", "-DCMAKE_BUILD_TYPE=Release",
        "-DCMAKE_CXX_FLAGS_RELEASE=-O0", *options)  # what compiles and runs is asked, not how fast
    run("cmake", "--build", folder)


def write_glance_cmake(folder):
    [cmake] = re.findall(r"```cmake\n(.*?)```", GLANCE.read_text(encoding="utf-8"), re.DOTALL)
    (folder / "CMakeLists.txt").write_text("cmake_minimum_required(VERSION 3.25)\nproject(glance CXX)\n" + cmake)


def check_undefined_symbol(folder, prefix):
    """A plugin that calls what nothing defines is refused by the linker, which names the symbol."""
    folder.mkdir()
    (folder / "thermometer.cc").write_text("""#include <iotcloud/drivers/plugin.h>
namespace weather { double calibrated(double reading); }  // its source was forgotten
class Thermometer : public iotcloud::drivers::Driver {
 public:
  std::vector<iotcloud::drivers::ChannelSpec> channels(const iotcloud::drivers::PropertyMap&) override { return {}; }
  void open(iotcloud::drivers::DriverContext&) override { weather::calibrated(21.5); }
};
IOTCLOUD_DRIVER(Thermometer, "thermometer", "1.0")
""")
    (folder / "thermostat.cc").write_text("""#include <iotcloud/topology/plugin.h>
namespace weather { double limit(); }
IOTCLOUD_TOPOLOGY_LIBRARY(registry) { static_cast<void>(registry); weather::limit(); }
""")
    write_glance_cmake(folder)
    run("cmake", "-S", folder, "-B", folder / "build", "-G", "Ninja", f"-DCMAKE_PREFIX_PATH={prefix}")
    for target, symbol in (("thermometer", "weather::calibrated(double)"), ("thermostat", "weather::limit()")):
        done = subprocess.run(["cmake", "--build", folder / "build", "--target", target], capture_output=True, text=True)
        said = done.stdout + done.stderr
        if done.returncode == 0 or "undefined reference to" not in said or symbol not in said:
            sys.exit(f"{target}.so that needs {symbol} is not refused by the linker: status {done.returncode}\n{said}")


def write_glance_project(folder):
    """The page's blocks, in the order in which it has them."""
    driver, bolt = re.findall(r"```cpp\n(.*?)```", GLANCE.read_text(encoding="utf-8"), re.DOTALL)
    folder.mkdir()
    (folder / "thermometer.cc").write_text(driver)
    (folder / "thermostat.cc").write_text(bolt)
    write_glance_cmake(folder)


def check_new_folders(work, prefix):
    """What `iotcloud new` makes builds against the prefix, and its tests pass; a project runs. All four are configured at once, and
    not optimized, which takes a third of the time."""
    work.mkdir()
    names = {"driver": "heat_pump", "bolt": "smooth", "topology": "alarms", "project": "greenhouse"}
    for kind, name in names.items():
        run(prefix / "bin/iotcloud", "new", kind, name, "--folder", work / name)
        if len((work / name / "README.md").read_text().splitlines()) > 10:
            sys.exit(f"the README of a new {kind} is longer than ten lines")
    (work / "CMakeLists.txt").write_text("cmake_minimum_required(VERSION 3.25)\nproject(all LANGUAGES CXX)\nenable_testing()\n" +
                                         "".join(f"add_subdirectory({name})\n" for name in names.values()))
    build(work, work / "build", prefix, "-DCMAKE_CXX_FLAGS_RELEASE=-O0")
    run("ctest", "--test-dir", work / "build", "--output-on-failure", "--no-tests=error")
    plugins = work / "build/greenhouse/plugins"
    run(prefix / "bin/iotcloud", "plugin", "check", plugins / "greenhouse_driver.so")
    for name in ("smooth", "alarms", "greenhouse"):
        run(prefix / "bin/iotcloud-topology", "--check", work / f"build/{name}/plugins/topology.yaml")
    running = subprocess.Popen([prefix / "bin/iotcloud", "run", plugins / "topology.yaml", "--plugin", plugins / "greenhouse_driver.so",
                                "--property", "period_ms=20", "--seconds", "120", "--stop-limit", "60"],
                               stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    said = ""
    for line in running.stdout:
        said += line
        if re.search(r"answer: took [1-9]\d*/s, emitted [1-9]", line):
            break
    else:
        sys.exit(f"a new project does not run, status {running.wait()}: {said}")
    running.send_signal(signal.SIGINT)
    rest, _ = running.communicate()
    if running.returncode:
        sys.exit(f"a new project does not stop, status {running.returncode}: {said}{rest}")
    again = subprocess.run([prefix / "bin/iotcloud", "new", "bolt", "smooth", "--folder", work / "smooth"], capture_output=True, text=True)
    if again.returncode != 1 or "is there already, and not empty: nothing was written" not in again.stderr:
        sys.exit(f"a folder that is there is written again: {again}")


def wait_for(what, condition, limit=120):
    deadline = time.monotonic() + limit
    while time.monotonic() < deadline:
        if condition():
            return
        time.sleep(0.05)
    sys.exit(f"not within {limit} s: {what}")


def main():
    tree = Path(sys.argv[1]).resolve()
    work = tree / "external"
    shutil.rmtree(work, ignore_errors=True)
    prefix, project = work / "prefix", work / "build"
    run("cmake", "--install", tree, "--prefix", prefix)
    build(HERE / "project", project, prefix)
    run("ctest", "--test-dir", project, "--output-on-failure", "--no-tests=error")
    shutil.copy(HERE / "project/words.yaml", project / "plugins")
    run(prefix / "bin/iotcloud-topology", "--check", project / "plugins/words.yaml")
    write_glance_project(work / "glance")
    build(work / "glance", work / "glance-build", prefix)
    check_undefined_symbol(work / "undefined", prefix)
    check_new_folders(work / "new", prefix)

    log = work / "orders.log"
    with PrivateCluster(work / "cluster", prefix / "bin", project / "plugins") as cluster:
        cluster.start(gateways=1)
        topology = (HERE / "project/topology.yaml").read_text()
        topology = topology.replace("127.0.0.1:2181", "{zookeeper}")
        cluster.topology("topology", topology.replace("thermostat.so", str(project / "plugins/thermostat.so")))
        cluster.wait_until_ready()
        cluster.deploy("thermometer.so", "gateway-1", {"log": log})
        wait_for(f"{ANSWERS} orders for the heater",
                 lambda: log.exists() and len(log.read_text().splitlines()) >= ANSWERS)
        cluster.undeploy_all()
        cluster.require_alive()

    for line in log.read_text().splitlines():
        instance, addressee, order = line.split()
        reading, heat = order.split("=")
        if instance != addressee or heat != ("on" if int(reading) < 20 else "off"):
            sys.exit(f"a wrong order: {line}")
    print(f"{len(log.read_text().splitlines())} orders, all right")


if __name__ == "__main__":
    main()
