#!/usr/bin/python3
"""The example storm_mix on a private Storm: Java, Python and C++ in one topology, started by a Flux file and by a Java program.
Each text, integer and double is counted by one task, whichever language emitted it, and nothing is lost or counted twice.
A value of Java that C++ cannot have fails its tuple, and says so.

usage: mix_on_storm.py BUILD LIBRARY     (BUILD: build/release; LIBRARY: the example's, storm_mix.so)
"""
import shutil
import subprocess
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "servers"))
from maven_build import build_once, package  # noqa: E402
from storm_case import StormCase, run  # noqa: E402
import storm_jar  # noqa: E402

ROOT = Path(__file__).resolve().parents[3]
EXAMPLE = ROOT / "examples" / "storm_mix"
FLUX = "org.apache.storm.flux.Flux"
ROUNDS = 50
# A spout of Java that comes with Storm emits a text, and then a map in its place.
ODD = """
name: odd
config: {topology.stats.sample.rate: 1.0}
components:
  - {id: fields, className: org.apache.storm.tuple.Fields, constructorArgs: [[name, by]]}
spouts:
  - id: odd
    className: org.apache.storm.testing.FixedTupleSpout
    constructorArgs: [[[Zürich, Java], [{a: 1}, Java], [Quito, Java]], {ref: fields}]
bolts:
  - {id: names, className: iotcloud.storm.CppBolt, constructorArgs: [storm_mix.so, mix.CountNames]}
  - {id: table, className: mix.Table, constructorArgs: [%s]}
streams:
  - {from: odd, to: names, grouping: {type: SHUFFLE}}
  - {from: names, to: table, grouping: {type: GLOBAL}}
"""
NUMBERS = {"-3", "7", "5000000000", "0", "-40", "128"}
KEYS = {"names": {"Zürich", "Bloomington", "東京", "", "two words", "Quito"}, "numbers": NUMBERS,
        "levels": {"0.30000000000000004", "-2.5", "1.0E-7", "2.0", "0.3333333333333333", "-1.0E21"}}
BELOW_ZERO = {"numbers": {"-3", "-40"}, "names": {"Zürich", "two words"}, "levels": {"0.30000000000000004", "0.3333333333333333"}}


def make(folder):
    shutil.rmtree(folder / "target", ignore_errors=True)
    package(EXAMPLE, "examples/storm_mix", folder)


class MixOnStorm(StormCase):
    limit_s = 300

    @classmethod
    def make_jars(cls):
        sources = [storm_jar.build(), EXAMPLE / "pom.xml", *EXAMPLE.glob("java/mix/*"), *EXAMPLE.glob("python/*.py")]
        cls.java = build_once(sources, ROOT / "build" / "storm_mix", make) / "mix.jar"

    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.jar = Path(cls.place.name) / "mixed.jar"
        program = [cls.build / "bin" / "iotcloud-storm", "pack", cls.library, cls.jar, "--onto", cls.java]
        subprocess.run(program, check=True)

    def flux_file(self, table, **changes):
        """The example's, with another table and fewer rounds."""
        text = (EXAMPLE / "mix.yaml").read_text()
        for old, new in {"/var/tmp/mix.table": str(table), "rounds: 1000": "rounds: %d" % ROUNDS, **changes}.items():
            self.assertIn(old, text)
            text = text.replace(old, new)
        file = table.with_suffix(".yaml")
        file.write_text(text)
        return file

    def check(self, table):
        self.wait_for("all readings are done", table.exists)
        head, *lines = table.read_text().splitlines()
        self.assertEqual(head, "acked %d\tfailed 0" % (ROUNDS * len(NUMBERS)))
        tasks = {component: set() for component in KEYS}
        expected = {(component, key): {"C++ %d" % (key not in BELOW_ZERO[component]): ROUNDS, "Java": ROUNDS, "Python": ROUNDS}
                    for component, keys in KEYS.items() for key in keys}
        for line in lines:
            component, key, task, *counts = line.split("\t")
            # A key that two tasks counted would have two lines, each with a part of this.
            self.assertEqual(dict((by, int(count)) for by, count in (each.rsplit(": ", 1) for each in counts)),
                             expected.pop((component, key), None), table.read_text())
            tasks[component].add(task)
        self.assertEqual(expected, {})
        for component, some in tasks.items():
            self.assertGreater(len(some), 1, component)
        self.assertEqual(self.table("errors", "mix"), [])
        self.ask("kill", "mix", "--wait", "0")

    def test_a_flux_file(self):
        table = Path(self.place.name) / "flux.table"
        submitted = self.storm_jar(self.jar, FLUX, self.flux_file(table))
        self.assertEqual(submitted.returncode, 0, submitted.stdout + submitted.stderr)
        self.check(table)

    def test_a_java_program(self):
        table = Path(self.place.name) / "java.table"
        submitted = self.storm_jar(self.jar, "mix.Main", table, str(ROUNDS))
        self.assertEqual(submitted.returncode, 0, submitted.stdout + submitted.stderr)
        self.check(table)

    def test_a_value_of_java_that_cpp_cannot_have_fails_its_tuple(self):
        file = Path(self.place.name) / "odd.yaml"
        file.write_text(ODD.replace("%s", str(file.with_suffix(".table"))))
        submitted = self.storm_jar(self.jar, FLUX, file)
        self.assertEqual(submitted.returncode, 0, submitted.stdout + submitted.stderr)
        self.wait_for("the component's error", lambda: self.table("errors", "odd"))
        (error,) = self.table("errors", "odd")
        self.assertEqual((error["component"], error["error"]), (
            "names", 'the field "name" of odd/default is a java.util.LinkedHashMap; C++ components take null, Boolean, '
            "Long (or Integer, Short, Byte), Double (or Float), String and byte[]"))

        def counts():
            return {row["component"]: (row["sum"]["acked"], row["sum"]["failed"]) for row in self.table("metrics", "odd")["components"]}
        self.wait_for("Storm's counts", lambda: counts().get("names") == (2, 1))
        self.assertEqual(len(self.storm.running_workers("odd")), 1)
        self.ask("kill", "odd", "--wait", "0")

    def test_a_class_that_is_not_in_the_library_is_refused_before_anything_is_sent(self):
        for name, said in (("mix.Relais", "storm_mix.so has no bolt mix.Relais; it has mix.CountNames, mix.Relay"),
                           ("mix.Readings", "storm_mix.so has no bolt mix.Readings; it has mix.CountNames, mix.Relay")):
            file = self.flux_file(Path(self.place.name) / "wrong.table", **{"so, mix.Relay]": "so, %s]" % name})
            submitted = self.storm_jar(self.jar, FLUX, file)
            self.assertNotEqual(submitted.returncode, 0)
            self.assertIn(said, submitted.stderr)
        self.assertEqual(self.table("list"), [])


if __name__ == "__main__":
    sys.exit(run(MixOnStorm, *sys.argv[1:3]))
