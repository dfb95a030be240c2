#!/usr/bin/python3
"""Says what chosen tests need, before anything is built.

usage: choose.py BUILD_FOLDER [CTEST OPTIONS]
       choose.py --left-out BUILD_FOLDER [CTEST OPTIONS]

The second form prints the chosen tests that CMake left out, because something that they need is not here: a line for
each with its name, a tab and what is missing, for summary.py. The first
prints two lines: the targets that build the tests which these options of ctest choose (-R, -E, -L, -LE), and what else
these tests need: servers (Debian's), tools (all other programs of system tests), java (servers from Maven Central, jni.h),
ros, browser (Chromium, and packages of npm), packages (what makes Debian packages, and a Debian to install them
on). It reads BUILD_FOLDER/test_list.tsv, which CMake writes. A test in it is known by name. Of a GoogleTest program it
reads the tests' names in the sources and, once it was built, in the list that ctest has of it; a program with a
parameterized test that has never been built is chosen when no name can rule it out.
"""
import re
import sys
from dataclasses import dataclass
from pathlib import Path

TEST = re.compile(r"^\s*(TEST|TEST_F|TEST_P|TYPED_TEST|TYPED_TEST_P)\(\s*(\w+)\s*,\s*(\w+)\s*\)", re.MULTILINE)
DISCOVERED = re.compile(r"^add_test\(\s*(?:\[=*\[)?(.+?)(?:\]=*\])?\s", re.MULTILINE)
# Options of ctest that take the next word as their value, unless they have one after "=". ./dev has the same list.
WITH_VALUE = ("-R", "-E", "-L", "-LE", "-I", "-j", "-C", "-FA", "-FS", "-FC", "-O", "--tests-regex", "--exclude-regex",
              "--label-regex", "--label-exclude", "--tests-information", "--parallel", "--build-config",
              "--fixture-exclude-any", "--fixture-exclude-setup", "--fixture-exclude-cleanup", "--repeat", "--timeout",
              "--stop-time", "--test-load", "--resource-spec-file", "--output-log", "--output-junit")
LONG = {"--tests-regex": "-R", "--exclude-regex": "-E", "--label-regex": "-L", "--label-exclude": "-LE"}


@dataclass
class Listed:
    """A line of test_list.tsv."""
    name: str
    is_program: bool
    labels: list
    targets: list
    sources: list
    missing: str

    @staticmethod
    def of(line):
        name, how, labels, targets, sources, missing = line.split("\t")
        return Listed(name, how == "program", labels.split(), targets.split(), sources.split(), missing)

    def needs(self):
        needs = {"java", "ros", "browser", "packages"}.intersection(self.labels)
        if self.labels[0] != "unit" and "serverless" not in self.labels:
            needs.add("servers")
        if self.labels[0] in ("system", "long"):
            needs.add("tools")
        return needs


class Options:
    """What ctest's options demand of a test's name and labels."""

    def __init__(self, words):
        self.regexes = {"-R": [], "-E": [], "-L": [], "-LE": []}
        words = list(words)
        while words:
            word = words.pop(0)
            word, equals, value = word.partition("=") if word.startswith("--") else (word, "", "")
            if not equals and word in WITH_VALUE and words:
                value = words.pop(0)
            word = LONG.get(word, word)
            if word in self.regexes:
                self.regexes[word].append(re.compile(value))

    def take_labels(self, labels):
        def has(regex):
            return any(regex.search(label) for label in labels)
        return all(map(has, self.regexes["-L"])) and not any(map(has, self.regexes["-LE"]))

    def take_name(self, name):
        return all(regex.search(name) for regex in self.regexes["-R"]) and not any(
            regex.search(name) for regex in self.regexes["-E"])

    def name_anything(self):
        return not self.regexes["-R"]


def discovered(build):
    """By program that was built, the names that ctest knows."""
    return {file.name.partition("[")[0]: DISCOVERED.findall(file.read_text(encoding="utf-8"))
            for file in build.glob("**/*[[]*[]]_tests.cmake")}


def has_chosen(built, listed, options):
    """Whether a program has, or may have, a test of a chosen name. `built`: the names of its tests; None: it is not built."""
    if options.name_anything():
        return True
    if any(map(options.take_name, built or [])):
        return True
    for source in listed.sources:
        text = Path(source).read_text(encoding="utf-8", errors="replace") if Path(source).exists() else ""
        for macro, suite, name in TEST.findall(text):
            if macro in ("TEST", "TEST_F"):
                if options.take_name(f"{suite}.{name}"):
                    return True
            elif built is None:
                return True
    return False


def chosen(build, words):
    """What these options of ctest choose, of all that is listed."""
    options = Options(words)
    built = {} if options.name_anything() else discovered(build)
    for line in (build / "test_list.tsv").read_text(encoding="utf-8").splitlines():
        listed = Listed.of(line)
        if not options.take_labels(listed.labels):
            continue
        if has_chosen(built.get(listed.name), listed, options) if listed.is_program else options.take_name(listed.name):
            yield listed


def choose(build, words):
    """Returns the targets and the needs of the chosen tests."""
    targets, needs = set(), set()
    for listed in chosen(build, words):
        targets.update(listed.targets)
        needs.update(listed.needs())
    return sorted(targets), sorted(needs)


def main():
    words = sys.argv[1:]
    left_out = words[:1] == ["--left-out"]
    if len(words) <= left_out:
        sys.exit(__doc__.split("\n\n")[1])
    if left_out:
        for listed in chosen(Path(words[1]), words[2:]):
            if listed.missing:
                print(f"{listed.name}\t{listed.missing}")
        return
    for line in choose(Path(words[0]), words[1:]):
        print(*line)


if __name__ == "__main__":
    main()
