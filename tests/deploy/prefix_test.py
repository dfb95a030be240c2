#!/usr/bin/python3
"""`cmake --install --prefix X`: sample configurations, units and pages are there, the paths in them follow the prefix, and the daemons take
the samples.

usage: prefix_test.py BUILD_DIR
"""

import re
import shutil
import subprocess
import sys
import unittest
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
BUILD = Path(sys.argv[1]).resolve()
WORK = BUILD / "prefix_test"
DAEMONS = {"master": ["iotcloud-master"], "gateway": ["iotcloud-gateway"], "pool": ["iotcloud-topology", "--pool"],
           "topology": ["iotcloud-topology"]}
PROGRAMS = ["iotcloud-master", "iotcloud-gateway", "iotcloud-topology", "iotcloud-driver-host", "iotcloud-robot", "loadgen"]
DOCUMENTS = "share/doc/iotcloud"
# State is where systemd keeps that of units, whatever the prefix; of the rest only this may be named outside of the prefix.
ELSEWHERE = re.compile(r"(?<![\w/.-])/(?:usr|etc)/[\w./@%-]+")
OF_DEBIAN = {"/usr/bin/stunnel4"}


def install(prefix, component, **options):
    done = subprocess.run(["cmake", "--install", str(BUILD), "--prefix", str(prefix), "--component", component], capture_output=True,
                          text=True, check=False, **options)
    if done.returncode:
        sys.exit(f"{component} cannot be installed below {prefix}:\n{done.stdout}{done.stderr}")


class Prefix(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        shutil.rmtree(WORK, ignore_errors=True)
        cls.prefix = WORK / "opt"
        for component in ("files", *PROGRAMS):
            install(cls.prefix, component)
        cls.usr = WORK / "root"
        install("/usr", "files", env={"PATH": "/usr/bin:/bin", "DESTDIR": str(cls.usr)})

    def texts(self, *folders):
        """(file, text) of the installed files in these folders whose paths people or systemd use."""
        for folder in folders:
            for file in sorted((self.prefix / folder).rglob("*")):
                if file.is_file() and file.suffix in (".service", ".socket", ".yaml", ".conf", ".env", ".md"):
                    yield file, file.read_text(encoding="utf-8")

    def test_units_and_samples_name_nothing_outside_of_it(self):
        seen = 0
        for file, text in self.texts("lib/systemd/system", f"{DOCUMENTS}/config", f"{DOCUMENTS}/fleet", f"{DOCUMENTS}/examples"):
            if file.name == "README.md" and file.parent.name != "fleet":
                continue  # about the project's own folder
            seen += 1
            self.assertEqual(set(ELSEWHERE.findall(text)) - OF_DEBIAN, set(), file)
        self.assertGreater(seen, 25)

    def test_units_start_the_installed_programs_with_configurations_of_the_prefix(self):
        for file, text in self.texts("lib/systemd/system"):
            for program in re.findall(r"^ExecStart=(\S+)", text, re.MULTILINE):
                self.assertTrue(Path(program).is_file(), f"{file}: {program}")
                self.assertTrue(program in OF_DEBIAN or program.startswith(f"{self.prefix}/bin/"), f"{file}: {program}")
            for config in re.findall(r"--config (\S+)", text):
                self.assertTrue(config.startswith(f"{self.prefix}/etc/iotcloud/"), f"{file}: {config}")
            for page in re.findall(r"^Documentation=file:(\S+)", text, re.MULTILINE):
                self.assertTrue(Path(page).is_file(), f"{file}: {page}")

    def test_daemons_take_the_samples(self):
        for name, words in DAEMONS.items():
            text = (self.prefix / DOCUMENTS / f"config/{name}.yaml").read_text(encoding="utf-8")
            # Accounts that packages make: here others stand for them.
            for account in ("iotcloud-host", "iotcloud-worker", "iotcloud-master"):
                text = re.sub(rf"(host_user: |worker_user: |users: \[){account}\b", r"\1nobody", text)
            file = WORK / f"{name}.yaml"
            file.write_text(text, encoding="utf-8")
            done = subprocess.run([self.prefix / "bin" / words[0], *words[1:], "--config", file, "--check-config"], capture_output=True,
                                  text=True, check=False)
            self.assertEqual(done.returncode, 0, f"{name}: {done.stdout}{done.stderr}")

    def test_the_gateways_sample_has_the_installed_drivers_and_hosts_of_another_user(self):
        text = (self.prefix / DOCUMENTS / "config/gateway.yaml").read_text(encoding="utf-8")
        [plugins] = re.findall(r"^plugins: (\S+)$", text, re.MULTILINE)
        self.assertTrue((Path(plugins) / "loadgen.so").is_file(), plugins)
        self.assertIn("\nhost_user: iotcloud-host\n", text)
        self.assertIn("\nhost_starter: /run/iotcloud-host\n", text)

    def test_the_usual_prefix_has_the_units_as_they_are(self):
        for file in sorted((ROOT / "deploy/systemd").glob("iotcloud-*")):
            installed = self.usr / "usr/lib/systemd/system" / file.name
            self.assertEqual(installed.read_text(encoding="utf-8"), file.read_text(encoding="utf-8"), file.name)

    def test_pages_are_there_with_what_they_link(self):
        pages = self.prefix / DOCUMENTS
        for page in ("README.md", "docs/packages.md", "docs/running.md", "deploy/README.md", "fleet/gateway.yaml", "drivers/mqtt/README.md"):
            self.assertTrue((pages / page).is_file(), page)
        text = (pages / "README.md").read_text(encoding="utf-8")
        for target in re.findall(r"\]\((?!https?:)([^)#]+\.(?:md|png))", text):
            self.assertTrue((pages / target).is_file(), f"README.md links {target}")


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1])
