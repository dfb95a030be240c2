#!/usr/bin/python3
"""What the Debian packages will have, before any is made: every installed file is in one package, and their fields, units, users and
scripts fit together (deploy/debian, development/package.py).

usage: package_files_test.py BUILD_DIR
"""

import re
import shutil
import subprocess
import sys
import unittest
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
BUILD = Path(sys.argv[1]).resolve()
DEBIAN, UNITS = ROOT / "deploy/debian", ROOT / "deploy/systemd"
sys.path.insert(0, str(ROOT / "development"))

import package  # noqa: E402

# What a build has only where something else is: ROS, GStreamer, jni.h and Maven, the site of ./dev docs.
MAY_BE_MISSING = {*(f"usr/lib/iotcloud/plugins/{plugin}.so" for plugin in ("turtle_ros", "ros", "camera")), "usr/share/doc/iotcloud/html"}
# Made by the packaging itself, which asks the programs.
GENERATED = ("usr/share/man/", "usr/share/bash-completion/", "usr/share/zsh/")


# Debian's packages of what the exported targets link.
DEVELOPMENT = {"nlohmann_json::nlohmann_json": "nlohmann-json3-dev", "fmt::fmt": "libfmt-dev", "spdlog::spdlog": "libspdlog-dev",
               "OpenSSL::SSL": "libssl-dev", "OpenSSL::Crypto": "libssl-dev", "ZLIB::ZLIB": "zlib1g-dev", "yaml-cpp": "libyaml-cpp-dev",
               "PkgConfig::thrift": "libthrift-dev", "PkgConfig::systemd": "libsystemd-dev", "PkgConfig::seccomp": "libseccomp-dev",
               "PkgConfig::rdkafka": "librdkafka-dev", "Boost::headers": "libboost-dev", "zookeeper_mt": "libzookeeper-mt-dev",
               "rabbitmq::rabbitmq": "librabbitmq-dev", "Snappy::snappy": "libsnappy-dev", "CLI11::CLI11": "libcli11-dev",
               "libzstd.so": "libzstd-dev", "liblz4.so": "liblz4-dev", "librocksdb.so": "librocksdb-dev", "libhiredis.so": "libhiredis-dev",
               "-l:libqpid-proton-core.so.10": "libqpid-proton11-dev"}
OF_THE_COMPILER = {"Threads::Threads", "dl"}


def fields():
    """The fields of each package in deploy/debian/control, by its name."""
    return {one["Package"]: one for one in package.paragraphs((DEBIAN / "control").read_text(encoding="utf-8")) if "Package" in one}


def script(name, kind):
    file = DEBIAN / f"{name}.{kind}"
    return file.read_text(encoding="utf-8") if file.exists() else ""


class Files(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        there = BUILD / "package_files"
        shutil.rmtree(there, ignore_errors=True)
        package.install(BUILD, there, [])
        cls.installed = sorted(path.relative_to(there).as_posix() for path in there.rglob("*") if not path.is_dir() or path.is_symlink())
        [targets] = there.glob("usr/lib/cmake/iotcloud/iotcloudTargets.cmake")
        cls.exported = targets.read_text(encoding="utf-8")
        shutil.rmtree(there)

    def test_the_sdks_need_what_their_targets_link(self):
        depends = set(re.split(r",\s*", fields()["iotcloud-dev"]["Depends"]))
        linked = set()
        for words in re.findall(r'INTERFACE_LINK_LIBRARIES "([^"]*)"', self.exported):
            for word in re.sub(r"\\?\$<LINK_ONLY:([^>]*)>", r"\1", words).split(";"):
                linked.add(word.rpartition("/")[2])
        linked = {word for word in linked if word and not word.startswith("iotcloud::")} - OF_THE_COMPILER
        self.assertGreater(len(linked), 10)
        for word in sorted(linked):
            self.assertIn(word, DEVELOPMENT, "a library of which this test does not know the package")
            self.assertIn(DEVELOPMENT[word], depends, f"iotcloud-dev in deploy/debian/control does not need it, and {word} does")

    def test_every_installed_file_is_in_exactly_one_package(self):
        patterns = [(name, pattern) for name in fields() for pattern in package.taken_by(name)]
        # Packages of Storm's side take what is there of it.
        patterns += [("iotcloud-storm", part) for part in package.OF_STORM]
        patterns += [("none", line) for line in (DEBIAN / "not-installed").read_text(encoding="utf-8").split()]
        self.assertGreater(len(self.installed), 200)
        for path in self.installed:
            takers = [name for name, pattern in patterns if package.takes(pattern, path)]
            self.assertEqual(len(takers), 1, f"{path} is in {takers}: deploy/debian says by NAME.install, and by stanzas of drivers in "
                             "control, which package has it")
        for name, pattern in patterns:
            if not pattern.startswith(GENERATED) and pattern not in (*MAY_BE_MISSING, *package.OF_STORM):
                self.assertTrue(any(package.takes(pattern, path) for path in self.installed), f"{name}: there is no {pattern}")

    def test_programs_and_their_units_are_in_the_same_package(self):
        for unit in sorted(UNITS.glob("*.service")):
            [program] = re.findall(r"^ExecStart=/usr/bin/([\w-]+)", unit.read_text(encoding="utf-8"), re.MULTILINE)
            owners = [name for name in fields() if f"usr/lib/systemd/system/{unit.name}" in package.taken_by(name)]
            expected = [name for name in fields() if f"usr/bin/{program}" in package.taken_by(name)]
            self.assertEqual(owners, expected or ["iotcloud-common"], unit.name)  # stunnel is not ours


class Fields(unittest.TestCase):
    def test_each_package_says_what_it_is_and_needs(self):
        for name, one in fields().items():
            with self.subTest(name):
                self.assertIn(one["Architecture"], ("any", "all"))
                first, *rest = one["Description"].splitlines()
                self.assertTrue(first and len(first) <= 80 and rest and not first.endswith("."), first)
                self.assertIn("${misc:Depends}", one["Depends"])
                self.assertEqual("${shlibs:Depends}" in one["Depends"], one["Architecture"] == "any" and name != "iotcloud-dev", one["Depends"])

    def test_drivers_come_with_what_loads_them_and_fits(self):
        loaders = {name for name, one in fields().items() if "iotcloud-driver-sdk-@DRIVER_SDK@" in one.get("Provides", "")}
        self.assertEqual(loaders, {"iotcloud", "iotcloud-gateway"})
        found = dict(package.drivers())
        self.assertGreaterEqual(len(found), 12)
        for name, plugin in found.items():
            self.assertEqual(name, f"iotcloud-driver-{plugin.replace('_', '-')}")
            self.assertIn("iotcloud-driver-sdk-@DRIVER_SDK@", fields()[name]["Depends"])

    def test_daemons_need_their_users(self):
        users = set(re.findall(r"^[ug] ([\w-]+)", (UNITS / "iotcloud.sysusers").read_text(encoding="utf-8"), re.MULTILINE))
        self.assertIn("usr/lib/sysusers.d/iotcloud.conf", package.taken_by("iotcloud-common"))
        self.assertIn("dh $@ --with installsysusers\n", (DEBIAN / "rules").read_text(encoding="utf-8"))  # else nobody makes them
        for unit in sorted(UNITS.glob("iotcloud-*")):
            named = set(re.findall(r"^(?:User|SocketUser)=(\S+)", unit.read_text(encoding="utf-8"), re.MULTILINE))
            self.assertLessEqual(named, users)
            for name in fields():
                if named and f"usr/lib/systemd/system/{unit.name}" in package.taken_by(name) and name != "iotcloud-common":
                    self.assertIn("iotcloud-common (= ${source:Version})", fields()[name]["Depends"], unit.name)

    def test_the_version_is_that_of_the_project(self):
        cmake = "project(iotcloud VERSION 1.2.3 LANGUAGES CXX)\n"
        self.assertEqual(package.version_of(f"x\n{cmake}", "# Changes\n\n## 1.2.3\n\n## 1.2.2\n", ("202601020304", "abc")), "1.2.3")
        self.assertEqual(package.version_of(cmake, "## The rule\n\n## Unreleased\n\n## 1.2.3\n", ("202601020304", "abc")),
                         "1.2.3+202601020304.abc")
        self.assertEqual(package.version_of(cmake, "## Unreleased\n", None), "1.2.3+unreleased")
        with self.assertRaisesRegex(package.Failed, "begins with 1.3.0.*says 1.2.3"):
            package.version_of(cmake, "## 1.3.0\n", None)
        real = package.version_of((ROOT / "CMakeLists.txt").read_text(encoding="utf-8"), (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"),
                                  ("202601020304", "abc"))
        self.assertRegex(real, r"^\d+\.\d+\.\d+(\+202601020304\.abc)?$")


class Units(unittest.TestCase):
    def test_what_is_enabled_waits_for_its_configuration(self):
        for unit in sorted(UNITS.glob("iotcloud-*")):
            text = unit.read_text(encoding="utf-8")
            if "[Install]" in text and "@" not in unit.name:
                self.assertRegex(text, r"(?m)^ConditionPathExists=/etc/iotcloud/\S+$", unit.name)
                for config in re.findall(r"--config (\S+)", text):
                    self.assertIn(f"ConditionPathExists={config}\n", text, unit.name)


class Scripts(unittest.TestCase):
    def test_a_shell_reads_them_and_they_end_at_an_error(self):
        found = [file for kind in ("preinst", "postinst", "prerm", "postrm") for file in sorted(DEBIAN.glob(f"*.{kind}"))]
        self.assertGreater(len(found), 5)
        for file in found:
            text = file.read_text(encoding="utf-8")
            self.assertEqual(text.splitlines()[:2], ["#!/bin/sh", "set -e"], file)
            self.assertIn("\n#DEBHELPER#\n", text, file)
            done = subprocess.run(["/bin/sh", "-n", file], capture_output=True, text=True, check=False)
            self.assertEqual((done.returncode, done.stderr), (0, ""), file)

    def test_purge_removes_state_and_configuration_and_nothing_else_does(self):
        for name in fields():
            units = [UNITS / pattern.rpartition("/")[2] for pattern in package.taken_by(name) if "systemd/system/" in pattern]
            text = script(name, "postrm")
            before, _, purge = text.partition('if [ "$1" = purge ]; then\n')
            self.assertNotIn("rm ", before, name)
            for unit in units:
                said = unit.read_text(encoding="utf-8")
                for state in re.findall(r"^StateDirectory=([\w-]+)", said, re.MULTILINE):
                    self.assertRegex(purge, rf"rm -rf .*/var/lib/{state}( |\n)", unit.name)
                for config in re.findall(r"^ConditionPathExists=(\S+)", said, re.MULTILINE):
                    self.assertIn(config, purge, unit.name)


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1])
