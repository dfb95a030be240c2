#!/usr/bin/python3
"""Makes one site of all of the project's Markdown, with search, and the reference of the public headers below api/.

usage: site.py API_DIR OUTPUT_DIR      (./dev docs; API_DIR: Doxygen's pages)

A browser that reads the pages from a disk lets them fetch nothing and start no worker from a file, so that MkDocs' search stands
still there; search/from_disk.js then has index and worker in itself.

MkDocs wants its pages in one folder: they are copied with the files that they link. A link to a folder leads to its README,
and is plain text if it has none. A page that cannot be made is an error, and so is a link that leads nowhere or out of the site,
which may be installed anywhere.
"""

import json
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import yaml

import links

ROOT = Path(__file__).resolve().parents[1]
LINK = re.compile(r"\[([^\]]*)\]\(([^)#\s]+)(#[^)\s]*)?\)")
TABS = (
    ("Start", ["README.md", "docs/tutorial.md", "docs/glance.md", "docs/comparison.md"]),
    ("Guides", ["docs/guide.md", "docs/driver-sdk.md", "docs/topology-sdk.md", "docs/running.md", "docs/operating.md", "docs/placement.md"]),
    ("Reference", ["docs/reference/README.md", "topology/definition/README.md", "docs/wire.md", "discovery/selection/README.md",
                   "SECURITY.md", "CHANGELOG.md"]),
    ("Inside", ["docs/README.md", "docs/design.md", "docs/walks.md", "CONTRIBUTING.md"]),
)
SETTINGS = {
    "site_name": "IoTCloud", "use_directory_urls": False, "strict": True,
    "theme": {"name": "material", "font": False, "features": ["navigation.tabs", "navigation.top", "search.suggest",
                                                              "search.highlight"]},
    "plugins": ["search"],
    "extra": {"homepage": "index.html"},  # else the logo leads to a folder, which a browser does not open from a disk
    "markdown_extensions": ["tables", "fenced_code", "admonition", {"toc": {"permalink": True}}],
}

# A template that is put over the theme's.
TEMPLATE = """{% extends "base.html" %}
{% block libs %}
  {{ super() }}
  <script>
    if (location.protocol === "file:") document.write('<script src="{{ "search/from_disk.js" | url }}"><\\/script>')
  </script>
{% endblock %}
"""


def documents():
    listed = subprocess.run(["git", "ls-files", "--cached", "--others", "--exclude-standard", "*.md"], cwd=ROOT, check=True,
                            capture_output=True, text=True).stdout
    return sorted(Path(line) for line in listed.splitlines() if (ROOT / line).exists())


def title(page):
    return next(line[2:] for line in (ROOT / page).read_text().splitlines() if line.startswith("# "))


def for_site(page, pages):
    """The page's text with links that lead somewhere in the site, and the other files that it links."""
    linked = set()

    def link(match):
        text, target, section = match[1], match[2], match[3] or ""
        if "://" in target:
            return match[0]
        file = (ROOT / page.parent / target).resolve().relative_to(ROOT)
        if (ROOT / file).is_dir():
            if file / "README.md" not in pages:
                return text
            return f"[{text}]({target.rstrip('/')}/README.md{section})"
        if file not in pages:
            linked.add(file)
            return f"[{text}]({target})"
        return match[0]

    return LINK.sub(link, (ROOT / page).read_text()), linked


def write_pages(folder):
    pages = documents()
    others = set()
    for page in pages:
        (folder / page).parent.mkdir(parents=True, exist_ok=True)
        text, linked = for_site(page, pages)
        (folder / page).write_text(text)
        others |= linked
    for file in others:
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / file, folder / file)
    return pages


def navigation(pages):
    named = {Path(page) for _, tab in TABS for page in tab}
    tabs = [{name: [{title(page): page} for page in tab]} for name, tab in TABS]
    rest = [{str(page.parent if page.name == "README.md" else page): str(page)} for page in pages if page not in named]
    return [*tabs, {"Rooms": rest}, {"Headers": "api/index.html"}]


def write_search_from_disk(site):
    """The variable that the theme's script asks for, with the search's index and the address of its worker."""
    [worker] = (site / "assets/javascripts/workers").glob("search.*.js")
    source = json.dumps(worker.read_text(encoding="utf-8"))
    index = (site / "search/search_index.json").read_text(encoding="utf-8")
    (site / "search/from_disk.js").write_text(
        f"var __search = {{index: Promise.resolve({index}),\n"
        f'worker: URL.createObjectURL(new Blob([{source}], {{type: "text/javascript"}}))}};\n', encoding="utf-8")


def main():
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    if not shutil.which("mkdocs"):
        sys.exit("there is no mkdocs; ./dev docs installs it")
    reference, output = Path(sys.argv[1]).resolve(), Path(sys.argv[2]).resolve()
    with tempfile.TemporaryDirectory() as folder:
        pages_folder = Path(folder) / "pages"
        pages = write_pages(pages_folder)
        (pages_folder / "api").mkdir()
        shutil.copytree(reference, pages_folder / "api", dirs_exist_ok=True)
        templates = Path(folder) / "templates"
        templates.mkdir()
        (templates / "main.html").write_text(TEMPLATE)
        theme = {**SETTINGS["theme"], "custom_dir": str(templates)}
        settings = {**SETTINGS, "theme": theme, "docs_dir": str(pages_folder), "site_dir": str(output), "nav": navigation(pages)}
        (Path(folder) / "mkdocs.yml").write_text(yaml.safe_dump(settings))
        done = subprocess.run(["mkdocs", "build", "--quiet", "--config-file", Path(folder) / "mkdocs.yml"],
                              capture_output=True, text=True)
    if done.returncode:
        sys.exit(done.stdout + done.stderr)
    write_search_from_disk(output)
    count = links.check(output)
    print(f"{len(pages)} pages and the reference of the headers are in {output}/index.html; all of {count} links lead somewhere")


if __name__ == "__main__":
    main()
