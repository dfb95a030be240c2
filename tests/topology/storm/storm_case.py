"""What tests of components on a private Storm have in common: the cluster, `iotcloud-storm`, and the files that the
components of components.cc write."""
import json
import os
import re
import subprocess
import sys
import tempfile
import time
import unittest
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "servers"))
from private_server import Unavailable, java_environment  # noqa: E402
from storm import Storm  # noqa: E402
import storm_jar  # noqa: E402

SKIPPED = 77


class StormCase(unittest.TestCase):
    """A private Storm for the tests of a class; `place` is a folder for their files."""

    build = library = storm = None
    limit_s = 120  # for each wait

    @classmethod
    def make_jars(cls):
        """Makes, with Maven, what the tests need. Raises Unavailable when it cannot be had."""
        storm_jar.build()

    @classmethod
    def setUpClass(cls):
        cls.place = tempfile.TemporaryDirectory(prefix="iotcloud-storm-")
        cls.addClassCleanup(cls.place.cleanup)
        cls.storm = Storm(os.path.join(cls.place.name, "storm"))
        cls.addClassCleanup(cls.storm.stop)
        cls.storm.start()

    def run_program(self, *words, program=("iotcloud-storm",)):
        return subprocess.run([self.build / "bin" / program[0], *program[1:], *words], text=True, capture_output=True,
                              check=False)

    def storm_jar(self, jar, main, *words):
        """As the command `storm jar` of Storm does it."""
        return subprocess.run(["java", "-Dstorm.jar=%s" % jar, "-cp", "%s/lib-worker/*:%s:%s/conf" % (
            self.storm.folder, jar, self.storm.folder), main, *words], capture_output=True, text=True, check=False,
                              env=java_environment())

    def ask(self, *words):
        done = self.run_program(*words, "--nimbus", self.storm.url())
        self.assertEqual(done.returncode, 0, done.stderr + self.logs())
        return done.stdout

    def table(self, *words):
        return json.loads(self.ask(*words, "-o", "json"))

    def artifacts(self, pattern):
        """Files that the workers left."""
        return sorted((Path(self.storm.folder) / "logs" / "workers-artifacts").rglob(pattern))

    def worker_pages(self):
        """The addresses of the pages /metrics that workers logged, of those that ended, too."""
        return {found[1] for log in self.artifacts("worker.log")
                if (found := re.search(r"metrics of this worker: (http://\S+/metrics)", log.read_text(errors="replace")))}

    def logs(self):
        """What the workers' logs say of errors, for a failure's text."""
        told = ""
        for file in self.artifacts("worker.log*"):
            lines = file.read_text(errors="replace").splitlines()
            errors = [number for number, line in enumerate(lines) if "[ERROR]" in line or file.suffix == ".err"]
            told += "\n== %s\n%s" % (file, "\n".join(line[:300] for number in errors[:3] for line in lines[number:number + 12]))
        return told

    def counts(self, folder, component):
        """By task, what it wrote: by word, a number."""
        return {int(file.suffix[1:]): {word: int(number) for word, number in map(str.split, file.read_text().splitlines())}
                for file in folder.glob(component + ".[0-9]*") if not file.name.endswith(".partial")}

    def wait_for(self, what, holds):
        limit = time.monotonic() + self.limit_s
        while not holds():
            self.assertLess(time.monotonic(), limit, "%s within %d s%s" % (what, self.limit_s, self.logs()))
            time.sleep(0.1)


def run(case, build, library):
    """Runs the tests of a StormCase. Returns the exit status of the program."""
    case.build, case.library = Path(build), Path(library)
    try:
        case.make_jars()
        tests = unittest.defaultTestLoader.loadTestsFromTestCase(case)
        return 0 if unittest.TextTestRunner().run(tests).wasSuccessful() else 1
    except Unavailable as reason:
        print(reason)
        return 1 if os.environ.get("CI") == "true" else SKIPPED
