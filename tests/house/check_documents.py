#!/usr/bin/python3
"""What the project's Markdown names is there: files and sections that it links, commands of ./dev, metrics, the files and
rooms of docs/walks.md, the rooms of docs/design.md, the tests of SECURITY.md, the C++ that any document prints, and the other
code that docs/driver-sdk.md and docs/topology-sdk.md print. So is every document, and section of one, that a source cites
(docs/wire.md#topics).

usage: check_documents.py ROOT
"""

import re
import subprocess
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "development"))
import check_includes  # noqa: E402
from project_files import project_files  # noqa: E402

LINK = re.compile(r"\[[^\]]*\]\(([^)#\s]*)(?:#([^)\s]*))?\)")
COMMAND = re.compile(r"\./dev ((?:bench |cluster )?[a-z]+)")
METRIC = re.compile(r"\biotcloud_[a-z_]+_(?:total|seconds|bytes|messages|connected|depth|capacity)\b")
HEADING = re.compile(r"#{1,6} +(.*)")
# A document in a comment or a string, not in a path that begins at the root of a machine.
CITATION = re.compile(r"(?<![\w/.}*-])((?:[\w.-]+/)*[\w-]+\.md)(?:#([\w-]+))?")
SOURCES = {".h", ".cc", ".thrift", ".py", ".cmake", ".yaml", ".yml", ".service", ".txt", ".sh"}
# A file in a document: in backticks, or in a node of a diagram.
NAMED_FILE = re.compile(r"(?<![\w/.-])((?:[\w-]+/)+[\w.-]+\.(?:h|cc|thrift|py|yaml|cmake|md))(?![\w/])")
# tests/external builds the code of these as it stands in them.
BUILT_AS_PRINTED = {"docs/glance.md", "docs/tutorial.md"}
# A row of a walk: its number, room, files, what happens.
STEP = re.compile(r"\| *\d+ *\| *([\w/ ]+?) *\| *(.*?) *\|.*\|$")
ENTERED = re.compile(r"\| *([\w/]+) *\| *(\d+) *\|$")
# A row of the table of rooms: the linked room, what it is, the rooms that it uses.
ROOM = re.compile(r"\| *\[([\w/]+)\]\([^)]*\) *\|[^|]*\| *([\w, ]*?) *\|$")

# A test that SECURITY.md names: one, those with such a beginning, or all of a suite; and one of a command.
TEST = re.compile(r"`([A-Z]\w+)\.((?:[A-Z]\w+)?)(\.\.\.|\*|)`")
COMMAND_TEST = re.compile(r"`([a-z]+(?:_[a-z]+){4,})`")


def commands(root):
    """The words behind ./dev that its usage knows."""
    usage = subprocess.run([root / "dev", "help"], capture_output=True, text=True, check=True).stdout
    known = {"help"}
    for line in usage.splitlines():
        if match := re.match(r"  ([a-z]+)(?: \[?([a-z|]+))?", line):
            known.add(match[1])
            known.update(f"{match[1]} {word}" for word in (match[2] or "").split("|"))
    return known


def lines_of(text):
    """(number, line, language of the block of code that it is in) of each line; None: it is in none."""
    language = None
    for number, line in enumerate(text.splitlines(), 1):
        if line.startswith("```"):
            yield number, line, language or line[3:]
            language = line[3:] if language is None else None
        else:
            yield number, line, language


def sections(file):
    """The names by which a Markdown file's sections are linked, as GitHub makes them."""
    found = set()
    for _, line, code in lines_of(file.read_text()):
        if code is None and (heading := HEADING.match(line)):
            text = re.sub(r"[^\w\- ]", "", heading[1].strip().lower()).replace(" ", "-")
            found.add(text)
    return found


def problems(root, files, known):
    sources = "".join(path.read_text() for path in project_files(root) if path.suffix == ".cc")
    for file in files:
        for number, line in enumerate(file.read_text().splitlines(), 1):
            place = f"{file.relative_to(root)}:{number}"
            for target, section in LINK.findall(line):
                if "://" in target:
                    continue
                linked = file.parent / target if target else file
                if not linked.exists():
                    yield f"{place}: there is no {target}"
                elif section and linked.suffix == ".md" and section not in sections(linked):
                    yield f"{place}: {target or 'this document'} has no section #{section}"
            for words in COMMAND.findall(line):
                if words not in known:
                    yield f"{place}: there is no ./dev {words}"
            for metric in METRIC.findall(line):
                if f'"{metric}"' not in sources:
                    yield f"{place}: there is no metric {metric}"


def citation_problems(root, files):
    for file in files:
        for number, line in enumerate(file.read_text().splitlines(), 1):
            for document, section in CITATION.findall(line):
                place = f"{file.relative_to(root)}:{number}"
                found = next((path for path in (file.parent / document, root / document) if path.exists()), None)
                if found is None:
                    yield f"{place}: there is no {document}"
                elif section and section not in sections(found):
                    yield f"{place}: {document} has no section #{section}"


def named_file_problems(root, file):
    """Every file that a document names, in its text or a diagram, is there, written from the root or its own folder."""
    for number, line, code in lines_of(file.read_text()):
        for name in NAMED_FILE.findall(line) if code in (None, "mermaid") else []:
            if not any((folder / name.removeprefix("iotcloud/")).exists() for folder in (root, file.parent)):
                yield f"{file.relative_to(root)}:{number}: there is no {name}"


def printed_code_problems(root, file, languages=("cpp",)):
    """Code that is printed is code that a test compiles: behind a link to a file comes what stands in that file."""
    text = file.read_text()
    for block in re.finditer(rf"^```(?:{'|'.join(languages)})\n(.*?)^```", text, re.DOTALL | re.MULTILINE):
        place = f"{file.relative_to(root)}:{text[:block.start()].count(chr(10)) + 1}"
        before = text[:block.start()].rstrip().rsplit("\n\n", 1)[-1]
        linked = [file.parent / target for target, _ in LINK.findall(before) if "://" not in target]
        if not linked or not linked[-1].is_file():
            yield f"{place}: no file is linked before this code"
        elif block[1] not in linked[-1].read_text():
            yield f"{place}: this code does not stand in {linked[-1].resolve().relative_to(root)}"


def walk_problems(root, file):
    """Each step of a walk says the room of its files, and each walk how often it enters each room. What is no folder (a
    server, a socket) is a step between two rooms."""
    place = file.relative_to(root)
    for walk in re.split(r"^## ", file.read_text(), flags=re.MULTILINE)[1:]:
        title = walk.splitlines()[0]
        rooms = []
        for step in filter(None, map(STEP.match, walk.splitlines())):
            rooms.append(step[1])
            for name in NAMED_FILE.findall(step[2]):
                if not name.startswith(step[1] + "/"):
                    yield f"{place}: {title}: {name} is not in {step[1]}"
        entered = [room for i, room in enumerate(rooms) if (i == 0 or rooms[i - 1] != room) and (root / room).is_dir()]
        told = {row[1]: int(row[2]) for row in filter(None, map(ENTERED.match, walk.splitlines()))}
        for room in sorted(set(entered) | told.keys()):
            if entered.count(room) != told.get(room, 0):
                yield f"{place}: {title}: {room} is entered {entered.count(room)} times, not {told.get(room, 0)}"


def room_problems(root, file):
    """The table of rooms says what check_includes.py allows."""
    told = {}
    for line in file.read_text().splitlines():
        if room := ROOM.match(line):
            told[room[1]] = None if room[2] == "everything" else sorted(filter(None, room[2].split(", ")))
    allowed = {**check_includes.ROOMS, **check_includes.PARTS}
    for room in sorted(told.keys() | allowed.keys()):
        rule = sorted(allowed[room]) if allowed.get(room) is not None else None
        if room not in told:
            yield f"{file.relative_to(root)}: the room {room} is missing"
        elif room not in allowed:
            yield f"{file.relative_to(root)}: check_includes.py knows no room {room}"
        elif told[room] != rule:
            yield f"{file.relative_to(root)}: {room} may use {', '.join(rule or []) or 'no room'}"


def named_test_problems(root, file):
    """Every test that SECURITY.md names is there: `Suite.Name`, `Suite.Beginning...`, `Suite.*`, or a test of a command,
    `in_lower_case_words`. Every cell of its table names one, or says that it is only said."""
    if not file.exists():
        return
    sources = "\n".join(path.read_text() for path in project_files(root / "tests")
                        if path.suffix == ".cc" or path.name == "CMakeLists.txt")
    place, text = file.relative_to(root), file.read_text()
    for suite, name, open_end in TEST.findall(text):
        if not re.search(rf"TEST(?:_F|_P)?\({suite}, {name}{'' if open_end else r'[)]'}", sources):
            yield f"{place}: there is no test {suite}.{name}{open_end}"
    for name in COMMAND_TEST.findall(text):
        if f"NAME {name} " not in sources:
            yield f"{place}: there is no test {name}"
    for number, line in enumerate(text.splitlines(), 1):
        if not line.startswith("| ") or line.startswith("| stolen |"):
            continue
        for cell in line.strip("|").split("|")[1:]:
            if not (TEST.search(cell) or COMMAND_TEST.search(cell) or re.search(r"\bsaid\b", cell)):
                yield f"{place}:{number}: no test of \"{cell.strip()[:60]}\", nor that it is only said"


def main():
    root = Path(sys.argv[1]).resolve()
    files = project_files(root)
    documents = [path for path in files if path.suffix == ".md"]
    own_test = "check_documents_test.py"  # it cites what is not there
    sources = [path for path in files if (path.suffix in SOURCES or path.name == "dev") and path.name != own_test]
    found = list(problems(root, documents, commands(root)))
    found += citation_problems(root, sources)
    for document in documents:
        found += named_file_problems(root, document)
    for document in documents:
        if document.relative_to(root).as_posix() not in BUILT_AS_PRINTED:
            whole = document.parent == root / "docs" and document.stem.endswith("-sdk")
            found += printed_code_problems(root, document, ("cpp", "cmake", "yaml") if whole else ("cpp",))
    found += walk_problems(root, root / "docs/walks.md")
    found += room_problems(root, root / "docs/design.md")
    found += named_test_problems(root, root / "SECURITY.md")
    for text in found:
        print(text)
    sys.exit(1 if found or not documents else 0)


if __name__ == "__main__":
    main()
