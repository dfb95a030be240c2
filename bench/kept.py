#!/usr/bin/python3
"""`./dev bench keep`: results of benchmarks that the project keeps, and the documents that show them.

usage: ./dev bench keep [NAME]...   copies results from build/bench to bench/results (NAME: runtime, paper/figure-7, ...;
                                    without a name: all that can be kept) and writes the blocks of all documents again
       bench/kept.py --check ROOT   says which blocks differ from their files, and writes nothing

Results are not typed into documents by hand. A document has a block for each file of bench/results that it shows:

    <!-- result: paper/figure-12 p50|p99 -->
    what this script writes
    <!-- end of result -->

The expression behind the name chooses figures by their names; without one the block shows those that have a target.
"""

import json
import re
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "development"))
import page  # noqa: E402
from figures import number  # noqa: E402
from project_files import project_files  # noqa: E402

BLOCK = re.compile(r"(<!-- result: (?P<name>[\w/.-]+)(?: (?P<chosen>[^\n]*?))? -->\n).*?(<!-- end of result -->)", re.S)
# What takes figures whose file does not have its benchmark's name; tests measure some beside what they test.
COMMANDS = {"pool": "./dev test -R topologies_are_submitted_to_pools",
            "recording": "./dev test --long -R ten_minutes_of_a_thousand_channels",
            "storm_faults": "./dev test --long -R storm_under_faults",
            "storm_shares": "./dev test --long -R storm_tasks_share",
            "paper/turtlebot-placed": "./dev bench paper --figure turtlebot-placed"}
NEEDED = ("machine", "commit", "command", "results")


class Unusable(Exception):
    """The project cannot keep these figures; the text says why."""


def read(file):
    """Reads the file that a benchmark wrote. Raises Unusable when it lacks the machine, the commit or the command, was
    taken from sources that are not committed, or is of a run that failed."""
    try:
        data = json.loads(file.read_text(encoding="utf-8"))
        missing = [key for key in NEEDED if key not in data]
    except (OSError, ValueError, TypeError) as error:
        raise Unusable(f"{file} cannot be read: {error}") from error
    if missing:
        raise Unusable(f"{file} has no {', '.join(missing)}")
    if data["commit"].endswith("-modified"):
        raise Unusable(f"{file} is of sources that no commit has: commit them, and take it again")
    if data.get("failed"):
        raise Unusable(f"{file} is of a run that failed: {data['failed']}")
    return data


def cell(text):
    return str(text or "").replace("|", "\\|").replace("\n", " ")


def row(result):
    ratio, of_rounds = number(result.get("ratio")), result.get("ratio_spread")
    if of_rounds:
        ratio += f" ({number(of_rounds[0])} to {number(of_rounds[1])})"
    beside = f"{number(result['baseline_value'])} {result.get('baseline') or ''}" if result.get("baseline_value") is not None else ""
    met = {True: ", met", False: ", **missed**", None: ""}[result.get("met")]
    cells = (result["name"], f"{number(result['value'])} {result.get('unit') or ''}", beside, ratio, (result.get("target") or "") + met)
    return f"| {' | '.join(cell(each).strip() for each in cells)} |"


def shown(results, name, chosen):
    """The text of a block: a line about the run (command, commit, machine), a table and the pictures. `results`: the
    folder of the kept files."""
    file = results / f"{name}.json"
    if not file.exists():
        command = name.removeprefix("paper/").replace("figure-", "paper --figure ").replace("storm-", "storm --")
        return f"No run is kept in the project; `{COMMANDS.get(name, f'./dev bench {command}')}` takes these figures.\n"
    data = read(file)
    rows = [row(result) for result in data["results"]
            if (re.search(chosen, result["name"]) if chosen else result.get("met") is not None)]
    if not rows:
        raise Unusable(f"{file} has no figure that is called {chosen!r}")
    machine, short = data["machine"], data["commit"][:12]
    load = machine.get("load_average_before")
    of = ", ".join([f"`{data['command']}`", f"commit {short}", f"{machine['cpu']}, {machine['cores']} cores",
                    *([f"load {number(load)} before"] if load is not None else []),
                    *(f"{key} {value}" for key, value in (data.get("versions") or {}).items()),
                    *([f"taken {data['taken']}"] if data.get("taken") else [])])
    pictures = [f"![{plot['title']}](PICTURES/{page.name_of(results, file)}-{index}.svg)"
                for index, plot in enumerate(data.get("plots", []), 1)]
    return "\n".join([f"{of}:", "", "| figure | here | beside it | ratio (of rounds) | target |", "|---|---|---|---|---|", *rows, "",
                      *pictures, ""])


def filled(document, results):
    """The document's text with each block written anew from its file."""
    folder = Path("../" * (len(document.parent.relative_to(results.parent.parent).parts))) / results.relative_to(results.parent.parent)

    def fill(found):
        text = shown(results, found["name"], found["chosen"]).replace("(PICTURES/", f"({folder.as_posix()}/plots/")
        return found[1] + text + found[4]
    return BLOCK.sub(fill, document.read_text(encoding="utf-8"))


def documents(root):
    """The Markdown files that have a block."""
    for file in project_files(root):
        if file.suffix == ".md" and BLOCK.search(file.read_text(encoding="utf-8")):
            yield file


def check(root):
    """Compares all blocks with their files. Returns a list of problems."""
    problems = []
    for file in sorted((root / "bench/results").rglob("*.json")):
        try:
            read(file)
        except Unusable as why:
            problems.append(str(why))
    for document in documents(root):
        try:
            if filled(document, root / "bench/results") != document.read_text(encoding="utf-8"):
                problems.append(f"{document.relative_to(root)}: a block is not what its file says; ./dev bench keep writes it")
        except Unusable as why:
            problems.append(f"{document.relative_to(root)}: {why}")
    return problems


def keep(root, names):
    """Copies the named results, draws their pictures and writes the blocks. Raises Unusable, for
    an unusable result before it copies any. Without names it takes all, and skips unusable ones with a line."""
    taken, results = root / "build/bench", root / "bench/results"
    chosen = bool(names)
    if not chosen:
        names = sorted(file.relative_to(taken).with_suffix("").as_posix() for file in taken.rglob("*.json"))
    figures = {}
    for name in names:
        try:
            read(taken / f"{name}.json")
        except Unusable as why:
            if chosen:
                raise
            print(f"skipped: {why}")
            continue
        figures[name] = (taken / f"{name}.json").read_text(encoding="utf-8")
    for name, text in figures.items():
        (results / name).parent.mkdir(parents=True, exist_ok=True)
        page.put(results / f"{name}.json", text)
    if results.exists():
        page.write_pictures(results)
    for document in list(documents(root)):
        page.put(document, filled(document, results))
    return list(figures)


def main():
    if sys.argv[1:2] == ["--check"]:
        problems = check(Path(sys.argv[2]).resolve())
        print("\n".join(problems), end="\n" if problems else "")
        sys.exit(1 if problems else 0)
    try:
        print("kept: " + (", ".join(keep(Path(__file__).resolve().parent.parent, sys.argv[1:])) or "nothing; the blocks are written"))
    except Unusable as why:
        sys.exit(str(why))


if __name__ == "__main__":
    main()
