#!/usr/bin/python3
"""The container image has every program and plugin that an installation has, and the libraries that component libraries of
users need; its stage `build` installs what `./dev` installs to compile them, and compiles them as the preset release does.

usage: programs_test.py
"""

import re
import sys
import unittest
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
NOT_IN_IMAGE = {"turtlebot-demo", "turtlebot-demo-view",  # ./dev demo
                "room", "thermostat", "vehicle", "fleet_map",  # small examples, for those who read their sources
                "iotcloud-storm",  # people submit with it from where Storm's jar was built: ./dev storm jar
                "camera",  # GStreamer's plugins are larger than all the rest: drivers/camera/README.md
                "storm_mix"}  # for Storm's workers, who find it in a jar
NOT_IN_STAGE = {"git", "ccache"}  # for people who change the sources
SOURCES = ("bench", "brokers", "check", "config", "discovery", "drivers", "examples", "gateway", "master", "processes", "rpc",
           "security", "topology")


def words_of(text, pattern):
    found = re.search(pattern, text, re.DOTALL)
    return set(found[1].replace("\\\n", " ").split())


class Image(unittest.TestCase):
    def setUp(self):
        self.dockerfile = (ROOT / "Dockerfile").read_text(encoding="utf-8")
        self.dev = (ROOT / "dev").read_text(encoding="utf-8")

    def test_has_every_program_and_plugin(self):
        installed = {name for folder in SOURCES for file in (ROOT / folder).rglob("CMakeLists.txt")
                     for name in re.findall(r"iotcloud_(?:program|plugin)\(\s*NAME ([\w-]+)", file.read_text(encoding="utf-8"))}
        self.assertIn("iotcloud", installed)
        self.assertEqual(words_of(self.dockerfile, r'ARG PROGRAMS="([^"]*)"'), installed - NOT_IN_IMAGE)

    def test_compiles_with_the_packages_of_dev(self):
        stage = words_of(self.dockerfile, r"AS build\n.*?--no-install-recommends((?:[^\n]*\\\n)*[^\n]*)\n")
        needed = set().union(*(words_of(self.dev, rf"\n{kind}_packages=\(([^)]*)\)") for kind in ("build", "store", "driver", "ros", "package")))
        self.assertEqual(stage, needed - NOT_IN_STAGE - {"python3-rosmaster", "ros-geometry-msgs", "ros-std-msgs", "libsasl2-modules", "lintian"})

    def test_has_the_files_of_the_packages_and_says_what_is_in_it(self):
        # The components become packages, which are taken apart; the runtime has nothing else of this project but a script.
        self.assertRegex(self.dockerfile, r"development/package\.py --out /out/packages [^\n]*--components \$\{PROGRAMS\} files ")
        runtime = re.search(r"\nFROM \S+ AS runtime\n(.*?)\nFROM ", self.dockerfile, re.DOTALL)[1]
        copied = re.findall(r"^COPY (?:--from=(\S+) )?(\S+) ", runtime, re.MULTILINE)
        self.assertEqual(copied, [("libraries", "/needed"), ("libraries", "/unpacked/usr/bin"), ("libraries", "/unpacked/usr/lib/iotcloud/plugins"),
                                  ("inventory", "/sbom.cdx.json"), ("", "deploy/cluster/with-registry-tunnel")])

    def test_compiles_as_the_preset_release_does(self):
        # Warnings are errors, and which ones GCC gives depends on how it compiles: only what is left out may differ.
        options = re.findall(r"cmake --preset release((?: -D\S+)*) \\\n && ninja", self.dockerfile)
        self.assertEqual(options, [" -DBUILD_TESTING=OFF -DIOTCLOUD_BENCHMARKS=ON"])

    def test_has_the_libraries_that_component_libraries_link(self):
        # The SDKs are linked statically, so what they need of Debian's must be there although no program here uses it.
        linked = {name.lower() for name in re.findall(r"\$\{(\w+)_LIBRARY\}", (ROOT / "topology/state/CMakeLists.txt").read_text())}
        self.assertEqual(linked, {"rocksdb", "hiredis"})
        stage = re.search(r"\nFROM \S+ AS libraries\n(.*?)\nFROM .*?\nFROM \S+ AS runtime\n(.*?)\nFROM ", self.dockerfile, re.DOTALL)
        packages = words_of(stage[1], r"--no-install-recommends((?:[^\n]*\\\n)*[^\n]*)\n")
        for name in linked:
            with self.subTest(name):
                package = next((each for each in packages if re.fullmatch(rf"lib{name}[\d.]+", each)), None)
                self.assertIsNotNone(package, "the stage `libraries` installs no package of it")
                file = f"/usr/lib/*-linux-gnu/lib{name}.so.{package.removeprefix('lib' + name)}"
                self.assertIn(f"{file}", re.search(r"stores=\$\(ls ([^)]*)\)", stage[1])[1].split(),
                              "that stage copies only what is linked and what it names")
                self.assertIn(file, stage[2].split(), "the stage `runtime` checks it with ldd")


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1])
