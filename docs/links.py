#!/usr/bin/python3
"""Checks that each link within a folder of HTML pages leads to a file of the folder, and to a section that is there. Such a
folder can be installed anywhere. Links to other machines are not followed.

usage: links.py FOLDER      (docs/site.py and docs/api.py check what they make)
"""

import html
import re
import sys
from pathlib import Path
from urllib.parse import unquote

TAG = re.compile(r"<[a-zA-Z][^<>]*>")
LINK = re.compile(r"""\s(?:href|src)\s*=\s*(?:"([^"]*)"|'([^']*)'|([^\s"'>]+))""", re.IGNORECASE)
NAME = re.compile(r"""\s(?:id|name)\s*=\s*(?:"([^"]*)"|'([^']*)'|([^\s"'>]+))""", re.IGNORECASE)
CODE = re.compile(r"<(script|style)\b[^>]*>.*?</\1>|<!--.*?-->", re.DOTALL | re.IGNORECASE)
ELSEWHERE = re.compile(r"[a-zA-Z][a-zA-Z0-9+.-]*:|//")  # a scheme, or another machine's name
ONLY_SERVERS_SHOW = {"404.html"}  # its links begin at the root of a server


def values(pattern, text):
    """The values of an attribute in all tags."""
    return [html.unescape(next(filter(None, found), "")) for tag in TAG.findall(text) for found in pattern.findall(tag)]


class Folder:
    def __init__(self, folder):
        self.root = Path(folder).resolve()
        self.texts, self.names = {}, {}

    def text(self, page):
        if page not in self.texts:
            text = page.read_text(encoding="utf-8", errors="replace")
            # The tag of a script may have a link, what stands in the script has none.
            self.texts[page] = CODE.sub(lambda found: TAG.match(found[0])[0] if found[1] else "", text)
        return self.texts[page]

    def sections(self, page):
        if page not in self.names:
            self.names[page] = set(values(NAME, self.text(page)))
        return self.names[page]

    def problem(self, page, link):
        """What is wrong with a link of a page; empty: it leads somewhere."""
        path, _, section = link.partition("#")
        path = unquote(path.partition("?")[0])
        target = (page.parent / path).resolve() if path else page
        if path.startswith("/") or not target.is_relative_to(self.root):
            return "leads out of the folder"
        if target.is_dir():
            return "leads to a folder, which a browser lists only where a server does it"
        if not target.is_file():
            return "there is no such file"
        if section and target.suffix == ".html" and unquote(section) not in self.sections(target):
            return "there is no such section"
        return ""

    def problems(self):
        """All links that lead nowhere, and how many there are."""
        found, count = [], 0
        for page in sorted(self.root.rglob("*.html")):
            if page.name in ONLY_SERVERS_SHOW:
                continue
            for link in sorted(set(values(LINK, self.text(page)))):
                if ELSEWHERE.match(link) or link in ("", "#"):
                    continue
                count += 1
                if problem := self.problem(page, link):
                    found.append(f"{page.relative_to(self.root)}: {link}: {problem}")
        return found, count


def check(folder):
    """Ends the process with all links that lead nowhere; returns how many lead somewhere."""
    found, count = Folder(folder).problems()
    if found or not count:
        sys.exit("\n".join([*found, f"{len(found)} of {count} links of {folder} lead nowhere"]))
    return count


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    print(f"{check(sys.argv[1])} links lead somewhere")
