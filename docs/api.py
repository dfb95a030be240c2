#!/usr/bin/python3
"""Builds the reference of the public headers with Doxygen. A warning of Doxygen is an error, and so is a class, an
enumeration or a free function that no comment describes. (A member needs words only where its name does not say all.) So is a
link of the pages that leads nowhere.

usage: api.py BUILD_DIR OUTPUT_DIR     (./dev docs; BUILD_DIR/public_headers.txt lists the headers of CMake's file sets)
"""

import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import links

HERE = Path(__file__).resolve().parent
CLASSES = ("class", "struct", "union")
OBVIOUS = ("::Options", "::Callbacks")


def quoted(paths):
    return " ".join(f'"{path}"' for path in paths)


def run_doxygen(headers, include, output, pages=()):
    """What Doxygen has to say against the headers."""
    shutil.rmtree(output, ignore_errors=True)
    output.mkdir(parents=True)
    settings = (HERE / "Doxyfile").read_text() + f"""
OUTPUT_DIRECTORY = "{output}"
STRIP_FROM_PATH = "{include}"
STRIP_FROM_INC_PATH = "{include}"
INCLUDE_PATH = "{include}"
INPUT = {quoted([*pages, *headers])}
"""
    (output / "Doxyfile").write_text(settings)
    done = subprocess.run(["doxygen", output / "Doxyfile"], capture_output=True, text=True)
    said = sorted(set(line.replace(f"{include}/", "") for line in done.stderr.splitlines()))
    return said or ([] if done.returncode == 0 else [f"doxygen ended with {done.returncode}"])


def drop_dead_contents(pages):
    """Doxygen lists the section "Classes" in the contents of a class whose nested classes are all private, and leaves it out."""
    for page in pages.glob("class*.html"):
        text = page.read_text(encoding="utf-8")
        if 'name="nested-classes"' not in text:
            page.write_text(re.sub(r'<a href="#nested-classes">Classes</a>(?: &#124;)?\n?', "", text), encoding="utf-8")


def described(definition):
    return any("".join(definition.find(part).itertext()).strip() for part in ("briefdescription", "detaileddescription"))


def place(definition):
    location = definition.find("location")
    return f"{location.get('file')}:{location.get('line')}"


def begins_with_words(definition, include):
    """Whether a comment stands above the declarations, without an empty line between them, that this one belongs to."""
    location = definition.find("location")
    lines = (include / location.get("file")).read_text().splitlines()
    for line in reversed(lines[:int(location.get("line")) - 1]):
        if not line.strip():
            return False
        if line.lstrip().startswith("//"):
            return True
    return False


def undescribed(output, include):
    """The classes, enumerations and free functions without a comment. One comment is enough for functions of one name or
    of one block; what Options and Callbacks are for says the class that they are in."""
    found = []
    for file in sorted((output / "xml").glob("*.xml")):
        for compound in ElementTree.parse(file).getroot().iter("compounddef"):
            kind, name = compound.get("kind"), compound.findtext("compoundname")
            if compound.get("prot") == "private":
                continue
            if kind in CLASSES and not described(compound) and not name.endswith(OBVIOUS):
                found.append(f"{place(compound)}: {name} is not described")
            if kind not in (*CLASSES, "namespace"):
                continue
            members = [m for m in compound.iter("memberdef") if m.get("prot") in (None, "public", "protected")]
            functions = {m.findtext("name") for m in members if m.get("kind") == "function" and described(m)}
            for member in members:
                own = member.findtext("name")
                if described(member) or own.startswith(("operator", "@", "to_string")):
                    continue
                free = member.get("kind") == "function" and kind == "namespace"
                if member.get("kind") == "enum" or (free and own not in functions
                                                    and not begins_with_words(member, include)):
                    found.append(f"{place(member)}: {name}::{own} is not described")
    return sorted(set(found))


def main():
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    if not shutil.which("doxygen"):
        sys.exit("there is no doxygen; ./dev docs installs it")
    build, output = Path(sys.argv[1]).resolve(), Path(sys.argv[2]).resolve()
    headers = (build / "public_headers.txt").read_text().splitlines()
    problems = run_doxygen(headers, build / "include", output, [HERE / "mainpage.dox"])
    problems += undescribed(output, build / "include")
    problems = [re.sub(r"^\S*?iotcloud/(?=[\w/]+\.h:)", "", problem) for problem in problems]
    if problems or not headers:
        sys.exit("\n".join([*problems, f"{len(problems)} problems in {len(headers)} public headers"]))
    drop_dead_contents(output / "html")
    print(f"{len(headers)} public headers are documented, with {links.check(output / 'html')} links")


if __name__ == "__main__":
    main()
