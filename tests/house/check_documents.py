#!/usr/bin/python3
"""What the project's Markdown names is there: files that it links, commands of ./dev, metrics.

usage: check_documents.py ROOT
"""

import re
import subprocess
import sys
from pathlib import Path

LINK = re.compile(r"\[[^\]]*\]\(([^)#\s]+)(?:#[^)]*)?\)")
COMMAND = re.compile(r"\./dev ((?:bench |cluster )?[a-z]+)")
METRIC = re.compile(r"\biotcloud_[a-z_]+_(?:total|seconds|bytes|messages|connected|depth|capacity)\b")


def commands(root):
    """The words behind ./dev that its usage knows."""
    usage = subprocess.run([root / "dev", "help"], capture_output=True, text=True, check=True).stdout
    known = {"help"}
    for line in usage.splitlines():
        if match := re.match(r"  ([a-z]+)(?: \[?([a-z|]+))?", line):
            known.add(match[1])
            known.update(f"{match[1]} {word}" for word in (match[2] or "").split("|"))
    return known


def problems(root, files, known):
    sources = "".join(path.read_text() for path in root.rglob("*.cc") if "build" not in path.relative_to(root).parts)
    for file in files:
        for number, line in enumerate(file.read_text().splitlines(), 1):
            place = f"{file.relative_to(root)}:{number}"
            for target in LINK.findall(line):
                if "://" not in target and not (file.parent / target).exists():
                    yield f"{place}: there is no {target}"
            for words in COMMAND.findall(line):
                if words not in known:
                    yield f"{place}: there is no ./dev {words}"
            for metric in METRIC.findall(line):
                if f'"{metric}"' not in sources:
                    yield f"{place}: there is no metric {metric}"


def main():
    root = Path(sys.argv[1]).resolve()
    files = [path for path in sorted(root.rglob("*.md")) if "build" not in path.relative_to(root).parts]
    found = list(problems(root, files, commands(root)))
    for text in found:
        print(text)
    sys.exit(1 if found or not files else 0)


if __name__ == "__main__":
    main()
