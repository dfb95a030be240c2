#!/usr/bin/python3
"""What is in the packages and in the container image, as CycloneDX 1.5 (JSON): development/package.py writes the file of each package
beside it, and the Dockerfile that of the image.

usage: sbom.py image --name NAME --version VERSION --own FOLDER --base STATUS --files FOLDER FILE

Nothing is listed by hand. Debian's packages of which a program links a library, also by way of others ("linked"), are found by ldd
and dpkg. Those of which a header was compiled into it ("compiled in", such as Boost's and CLI11's, which have no library) are found by
ninja's record of what each object was made of. The console's page has code from npm, which its package-lock.json names.
"""

import argparse
import base64
import hashlib
import json
import re
import subprocess
import sys
import tempfile
import uuid
from datetime import datetime, timezone
from pathlib import Path
from urllib.parse import quote

ROOT = Path(__file__).resolve().parent.parent  # in the image this file is alone
LOCK = ROOT / "master/console/page/package-lock.json"
LINKED, COMPILED_IN, INSTALLED = "linked", "compiled in", "installed"


def run(*command, **options):
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, check=False, **options)
    if done.returncode:
        sys.exit(f"{' '.join(map(str, command))}: exit status {done.returncode}\n{done.stdout}{done.stderr}")
    return done.stdout


def is_elf(file):
    with open(file, "rb") as stream:
        return stream.read(4) == b"\x7fELF"


class Machine:
    """What dpkg knows on this machine."""

    def __init__(self):
        self.owners = {}
        for listed in Path("/var/lib/dpkg/info").glob("*.list"):
            package = listed.stem.partition(":")[0]
            for line in listed.read_text(encoding="utf-8", errors="replace").splitlines():
                self.owners[self.same(line)] = package

    @staticmethod
    def same(path):
        """One name for what is reached by /lib and by /usr/lib."""
        return path.removeprefix("/usr")

    def owner(self, path):
        """The package of a file; None: it is no package's."""
        real = str(Path(path).resolve())
        return self.owners.get(self.same(real)) or self.owners.get(self.same(str(path)))

    @staticmethod
    def fields(packages):
        """What dpkg says of these packages: a dictionary each, by their names."""
        if not packages:
            return {}
        said = run("dpkg-query", "-W", "-f=${Package}\t${Version}\t${Architecture}\t${source:Package}\t${Maintainer}\t${Homepage}\n",
                   *sorted(packages))
        return {line.split("\t")[0]: dict(zip(("name", "version", "arch", "source", "maintainer", "homepage"), line.split("\t")))
                for line in said.splitlines()}


def licenses_of(package):
    """The names of licences in a package's copyright file, if a machine can read it."""
    file = Path(f"/usr/share/doc/{package}/copyright")
    text = file.read_text(encoding="utf-8", errors="replace") if file.exists() else ""
    if not text.startswith("Format:"):
        return []
    return sorted({line.strip() for line in re.findall(r"^License:[ \t]*(\S.*)$", text, re.MULTILINE)})


def debian_component(fields, how, licenses):
    component = {
        "type": "library", "name": fields["name"], "version": fields["version"],
        "purl": f"pkg:deb/debian/{quote(fields['name'])}@{quote(fields['version'], safe='')}?arch={fields['arch']}&distro=debian-12",
        "supplier": {"name": fields["maintainer"]},
        "properties": [{"name": "iotcloud:how", "value": how}, {"name": "debian:source", "value": fields["source"]}]}
    component["bom-ref"] = component["purl"]
    if licenses:
        component["licenses"] = [{"license": {"name": name}} for name in licenses]
    if re.match(r"https?://\S+$", fields["homepage"]):
        component["externalReferences"] = [{"type": "website", "url": fields["homepage"]}]
    return component


def npm_components():
    """What esbuild puts into the console's page: what package.json needs, and what that needs."""
    locked = json.loads(LOCK.read_text(encoding="utf-8"))["packages"]
    found, waiting = {}, list(locked[""]["dependencies"])
    while waiting:
        name = waiting.pop()
        entry = locked[f"node_modules/{name}"]
        waiting += [needed for needed in entry.get("dependencies", {}) if needed not in found]
        purl = f"pkg:npm/{quote(name, safe='/')}@{entry['version']}"
        found[name] = {"type": "library", "name": name, "version": entry["version"], "purl": purl, "bom-ref": purl,
                       "properties": [{"name": "iotcloud:how", "value": COMPILED_IN}]}
        if "license" in entry:
            found[name]["licenses"] = [{"license": {"name": entry["license"]}}]
        kind, _, digest = entry["integrity"].partition("-")
        found[name]["hashes"] = [{"alg": kind.upper().replace("SHA", "SHA-"), "content": base64.b64decode(digest).hex()}]
    return [found[name] for name in sorted(found)]


class Build:
    """What ninja knows of a build: of which objects a program was made, and which headers each object read."""

    def __init__(self, folder, machine):
        self.folder = folder
        self.packages = {}  # of each object, by its name: those of the headers that it read
        known, current = {}, None
        with subprocess.Popen(["ninja", "-C", str(folder), "-t", "deps"], stdout=subprocess.PIPE, text=True) as ninja:
            for line in ninja.stdout:
                if not line.startswith(" "):
                    current = self.packages.setdefault(line.partition(":")[0], set()) if line.strip() else None
                elif current is not None and line.startswith("    /usr/"):
                    path = line.strip()
                    if path not in known:
                        known[path] = machine.owner(path)
                    if known[path]:
                        current.add(known[path])
        if ninja.returncode or not self.packages:
            sys.exit(f"{folder} does not know which headers were compiled: build it again")
        self.outputs = {}
        for line in run("ninja", "-C", folder, "-t", "targets", "all").splitlines():
            output = line.partition(":")[0]
            self.outputs.setdefault(Path(output).name, []).append(output)

    def compiled_in(self, name):
        """Debian's packages of which a header was compiled into the program, plugin or library with this name."""
        outputs = [output for output in self.outputs.get(name, []) if (self.folder / output).is_file()]
        found = set()
        for line in run("ninja", "-C", self.folder, "-t", "inputs", *outputs).splitlines() if outputs else []:
            found |= self.packages.get(line, set())
        return found


def linked(file, machine):
    """(packages of libraries that the file itself names, those that it gets with them), of Debian's."""
    named = set(re.findall(r"\(NEEDED\).*\[(.*)\]", run("readelf", "--dynamic", "--wide", file)))
    direct, all_of_them = set(), set()
    for name, path in re.findall(r"^\s*(\S+)(?: => (/\S+))? \(0x", run("ldd", file), re.MULTILINE):
        package = machine.owner(path or name) if (path or name).startswith("/") else None
        if package:
            all_of_them.add(package)
            if name in named:
                direct.add(package)
    return direct, all_of_them


def document(main, components, direct, when):
    """The whole file."""
    listed = {component["bom-ref"]: component for component in components}
    identity = f"{main['purl']} {main.get('hashes', [{}])[0].get('content', when)}"
    return {
        "$schema": "http://cyclonedx.org/schema/bom-1.5.schema.json", "bomFormat": "CycloneDX", "specVersion": "1.5",
        "serialNumber": f"urn:uuid:{uuid.uuid5(uuid.NAMESPACE_URL, identity)}", "version": 1,
        "metadata": {"timestamp": datetime.fromtimestamp(when, timezone.utc).strftime("%Y-%m-%dT%H:%M:%SZ"),
                     "tools": {"components": [{"type": "application", "name": "iotcloud development/sbom.py"}]}, "component": main},
        "components": [listed[ref] for ref in sorted(listed)],
        "dependencies": [{"ref": main["bom-ref"], "dependsOn": sorted(ref for ref in listed if ref in direct)},
                         *({"ref": ref} for ref in sorted(listed))]}


def own_component(name, version, arch, kind="application"):
    purl = f"pkg:deb/iotcloud/{name}@{quote(version, safe='')}?arch={arch}"
    return {"type": kind, "name": name, "version": version, "purl": purl, "bom-ref": purl,
            "licenses": [{"license": {"id": "Apache-2.0"}}]}


def of_packages(packages, build, when):
    """Writes the SBOM of each package (a .deb) beside it. `build`: the folder of the build that they are made of. `when`: their
    time, in seconds since 1970."""
    machine = Machine()
    known = Build(build, machine)
    for package in packages:
        name, version, arch = (run("dpkg-deb", "--field", package, field).strip() for field in ("Package", "Version", "Architecture"))
        main = own_component(name, version, arch)
        main["hashes"] = [{"alg": "SHA-256", "content": hashlib.sha256(package.read_bytes()).hexdigest()}]
        direct, all_linked, headers, files = set(), set(), set(), set()
        with tempfile.TemporaryDirectory() as folder:
            run("dpkg-deb", "--extract", package, folder)
            for file in sorted(Path(folder).rglob("*")):
                if file.is_symlink() or not file.is_file():
                    continue
                files.add(file.name)
                if is_elf(file):
                    of_file = linked(file, machine)
                    direct |= of_file[0]
                    all_linked |= of_file[1]
                if is_elf(file) or file.suffix == ".a":
                    headers |= known.compiled_in(file.name)
        components = [debian_component(fields, LINKED, licenses_of(one)) for one, fields in machine.fields(all_linked).items()]
        needed = {component["bom-ref"] for component in components if component["name"] in direct}
        compiled = [debian_component(fields, COMPILED_IN, licenses_of(one)) for one, fields in machine.fields(headers).items()]
        if "iotcloud-master" in files or "iotcloud-run" in files:  # these serve the console
            compiled += npm_components()
        needed |= {component["bom-ref"] for component in compiled}
        text = json.dumps(document(main, components + compiled, needed, when), indent=1)
        package.with_suffix(".cdx.json").write_text(text + "\n", encoding="utf-8")


def packages_of(status):
    """Names of the installed packages in a file like /var/lib/dpkg/status."""
    return {re.search(r"^Package: (\S+)", part, re.MULTILINE)[1] for part in status.read_text(encoding="utf-8").split("\n\n")
            if re.search(r"^Status: install ok installed", part, re.MULTILINE)}


def of_image(name, version, own, base, files):
    """The SBOM of an image: our packages in the folder `own` with what is in them, the packages of its base, whose dpkg had the
    status file `base`, and those of which `files` has files, on the machine that they were copied from."""
    machine = Machine()
    base_packages = packages_of(base)
    copied = {machine.owner("/" + str(file.relative_to(files))) for file in files.rglob("*") if file.is_file()} - {None} - base_packages
    components = [debian_component(fields, INSTALLED, licenses_of(one)) for one, fields in machine.fields(base_packages | copied).items()]
    for file in sorted(own.glob("*.cdx.json")):
        listed = json.loads(file.read_text(encoding="utf-8"))
        if listed["metadata"]["component"]["purl"].endswith("?arch=all"):
            continue  # the image has programs and plugins only: no units, samples and pages
        components += [listed["metadata"]["component"], *(component for component in listed["components"]
                                                          if component["properties"][0]["value"] == COMPILED_IN)]
    purl = f"pkg:oci/{name}@{quote(version, safe='')}"
    main = {"type": "container", "name": name, "version": version, "purl": purl, "bom-ref": purl}
    when = max(int(file.stat().st_mtime) for file in own.glob("*.cdx.json"))
    return document(main, components, {component["bom-ref"] for component in components}, when)


def main():
    options = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    kinds = options.add_subparsers(required=True)
    image = kinds.add_parser("image")
    for word in ("--name", "--version"):
        image.add_argument(word, required=True)
    for word in ("--own", "--base", "--files"):
        image.add_argument(word, required=True, type=Path)
    image.add_argument("file", type=Path)
    given = options.parse_args()
    made = of_image(given.name, given.version, given.own, given.base, given.files)
    given.file.write_text(json.dumps(made, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
