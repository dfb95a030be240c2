#!/usr/bin/python3
"""Makes the Debian packages of a build that is there, and an SBOM of each: ./dev package.

usage: package.py [--build BUILD_DIR] [--out FOLDER] [--version VERSION] [--components NAME...] [--no-lint] [--fast]

CMake installs the build below /usr of an empty folder, this program adds manual pages and completions, and debhelper makes packages
of it, by the files of deploy/debian. A file that no package takes is an error. Lintian's errors and warnings are, too.

--version: of the packages; without it that of CMakeLists.txt and CHANGELOG.md (version_of()).
--components: CMake's install components, of a build that has no others; makes the packages whose files are there, for the
container image.
--fast: archives are compressed less, in a tenth of the time.
"""

import argparse
import email.utils
import fnmatch
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
DEBIAN = ROOT / "deploy/debian"
sys.path.insert(0, str(ROOT / "development"))

import sbom  # noqa: E402

# Who made the packages, if the environment does not say it (DEBFULLNAME, DEBEMAIL): an address that is nobody's.
MAINTAINER = "IoTCloud", "iotcloud@example.org"
# The section of a program's manual page: 8 for daemons and what they start.
DAEMONS = {"iotcloud-master", "iotcloud-gateway", "iotcloud-driver-host", "iotcloud-topology", "iotcloud-robot"}
# Storm's side, where CMake found jni.h and where Maven made the jar.
OF_STORM = ("usr/lib/iotcloud/storm", "usr/share/iotcloud/storm")


class Failed(Exception):
    """What a person is told; no trace is needed."""


def run(*command, **options):
    """What a command prints. Raises Failed with all that it said."""
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, check=False, **options)
    if done.returncode:
        raise Failed(f"{' '.join(map(str, command))}: exit status {done.returncode}\n{done.stdout}{done.stderr}")
    return done.stdout


def say(text):
    print(text, flush=True)


def version_of(cmake, changes, commit):
    """The version of packages: that of CMakeLists.txt (its text), if CHANGELOG.md (its text) begins with it; with the commit's
    time and name (a pair, or None) behind it, if that begins with what is not released yet."""
    number = re.search(r"^project\(iotcloud VERSION ([\d.]+)", cmake, re.MULTILINE)[1]
    newest = re.search(r"^## (Unreleased|\d[\d.]*)$", changes, re.MULTILINE)[1]
    if newest == "Unreleased":
        return f"{number}+{f'{commit[0]}.{commit[1]}' if commit else 'unreleased'}"
    if newest != number:
        raise Failed(f"CHANGELOG.md begins with {newest}, and CMakeLists.txt says {number}: a release is in both")
    return number


def version_here():
    """That of the sources that are here."""
    return version_of((ROOT / "CMakeLists.txt").read_text(encoding="utf-8"), (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), commit())


def commit():
    """(time as YYYYMMDDhhmm, UTC, and short name) of the commit that is checked out; None without git."""
    done = subprocess.run(["git", "-C", ROOT, "log", "-1", "--format=%cd %h", "--date=format-local:%Y%m%d%H%M"], capture_output=True,
                          text=True, env={**os.environ, "TZ": "UTC"}, check=False)
    return tuple(done.stdout.split()) if done.returncode == 0 else None


def time_of_sources():
    """Seconds since 1970, for the packages' changelog and their files' times: of the commit, or of CHANGELOG.md without git."""
    done = subprocess.run(["git", "-C", ROOT, "log", "-1", "--format=%ct"], capture_output=True, text=True, check=False)
    return int(done.stdout) if done.returncode == 0 else int((ROOT / "CHANGELOG.md").stat().st_mtime)


def sdk_version():
    """What drivers are built for, and who loads them says that it takes."""
    return re.search(r"define IOTCLOUD_DRIVER_SDK_VERSION (\d+)", (ROOT / "drivers/plugin.h").read_text(encoding="utf-8"))[1]


def paragraphs(text):
    """The paragraphs of a control file, each as a dictionary of its fields."""
    found = []
    for paragraph in re.split(r"\n\n+", text.strip()):
        fields = re.findall(r"^([A-Z][\w-]*):(.*(?:\n[ \t].*)*)", paragraph, re.MULTILINE)
        found.append({name: value.strip() for name, value in fields})
    return found


def drivers():
    """(package, plugin) of each driver that has a package of its own."""
    for fields in paragraphs((DEBIAN / "control").read_text(encoding="utf-8")):
        if fields.get("Package", "").startswith("iotcloud-driver-"):
            yield fields["Package"], re.search(r"plugin (\w+)\.so", fields["Description"])[1]


def taken_by(package):
    """Patterns of the installed files that a package takes, from the file NAME.install or by the rule for drivers."""
    plugin = dict(drivers()).get(package)
    if plugin:
        return [f"usr/lib/iotcloud/plugins/{plugin}.so"]
    file = DEBIAN / f"{package}.install"
    return [line.split()[0] for line in file.read_text(encoding="utf-8").splitlines()] if file.exists() else []


def takes(pattern, path):
    """Whether a pattern takes the file: it is the file, a folder above it, or matches one of the two."""
    parts = path.split("/")
    return any(fnmatch.fnmatchcase("/".join(parts[:count]), pattern) for count in range(1, len(parts) + 1)
               if pattern.count("/") == count - 1)


def install(build, there, components):
    """CMake's installation below /usr of the folder `there`."""
    environment = {**os.environ, "DESTDIR": str(there)}
    for part in components or [None]:
        run("cmake", "--install", build, "--prefix", "/usr", *(["--component", part] if part else []), env=environment)


def verbs(program, *words):
    """(words, help) of each verb of the command line, and of the verbs of a family."""
    said = run(program, *words, "--help")
    _, _, listed = said.partition("\nSubcommands:\n")
    for verb in re.findall(r"^  ([a-z][\w-]*)", listed, re.MULTILINE):
        yield (*words, verb), run(program, *words, verb, "--help")
        yield from verbs(program, *words, verb)


def manual_of_verbs(program):
    """Sections for the manual page of the command line."""
    parts = ["[VERBS]"]
    for words, said in verbs(program):
        text = said.rstrip().replace("\\", "\\e").replace("-", "\\-")
        parts += [f".SS {program.name} {' '.join(words)}", ".nf", *(f"\\&{line}" for line in text.splitlines()), ".fi"]
    return "\n".join(parts) + "\n"


def manual_pages(there, version):
    """A page for each program, from what its --help says."""
    programs = sorted((there / "usr/bin").iterdir())
    for program in programs:
        section = 8 if program.name in DAEMONS else 1
        folder = there / f"usr/share/man/man{section}"
        folder.mkdir(parents=True, exist_ok=True)
        others = ", ".join(f"{other.name}({8 if other.name in DAEMONS else 1})" for other in programs if other != program)
        more = there.parent / f"{program.name}.h2m"  # what help2man adds
        own = manual_of_verbs(program) if program.name == "iotcloud" else ""
        also = f"[SEE ALSO]\n{others}\n.PP\nThe pages in /usr/share/doc/iotcloud, of the package iotcloud-doc.\n"
        more.write_text(own + also, encoding="utf-8")
        page = run("help2man", "--no-info", f"--section={section}", f"--version-string={version}", f"--name={purpose(program)}",
                   f"--include={more}", "--source=IoTCloud", program)
        (folder / f"{program.name}.{section}").write_text(page, encoding="utf-8")


def purpose(program):
    """What a program is for: the first line of its --help that is no heading."""
    for line in run(program, "--help").splitlines():
        if line.strip() and not line.lower().startswith("usage"):
            return line.strip().rstrip(".")
    raise Failed(f"{program.name} --help says nothing")


def completions(there):
    program = there / "usr/bin/iotcloud"
    for shell, place in (("bash", "bash-completion/completions/iotcloud"), ("zsh", "zsh/vendor-completions/_iotcloud")):
        file = there / "usr/share" / place
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(run(program, "completion", shell), encoding="utf-8")


def write_debian(folder, there, version, is_part):
    """debian/ for what is installed in the folder `there`: without packages of which nothing is there. `is_part`: nor those of which
    something is missing, and nobody takes the rest of them. Returns the packages."""
    folder.mkdir(parents=True)
    installed = [path.relative_to(there).as_posix() for path in there.rglob("*") if not path.is_dir() or path.is_symlink()]
    for file in DEBIAN.iterdir():
        shutil.copy(file, folder)
    name, address = os.environ.get("DEBFULLNAME", MAINTAINER[0]), os.environ.get("DEBEMAIL", MAINTAINER[1])
    control, *packages = (DEBIAN / "control").read_text(encoding="utf-8").split("\n\n")
    kept = []
    for text in packages:
        package = text.split()[1]
        missing = [pattern for pattern in taken_by(package) if not any(takes(pattern, path) for path in installed)]
        if missing and (is_part or len(missing) == len(taken_by(package))):
            say(f"{package} is left out: this build does not have {', '.join(missing)}")
            continue
        if missing:
            raise Failed(f"{package}: not installed: {', '.join(missing)}")
        kept.append(text.strip())
    text = "\n\n".join([control, *kept]) + "\n"
    for word, value in {"@MAINTAINER@": f"{name} <{address}>", "@DRIVER_SDK@": sdk_version()}.items():
        text = text.replace(word, value)
    (folder / "control").write_text(text, encoding="utf-8")
    for package, plugin in drivers():
        (folder / f"{package}.install").write_text(f"usr/lib/iotcloud/plugins/{plugin}.so\n", encoding="utf-8")
        (folder / f"{package}.postrm").write_text(f"""#!/bin/sh
set -e
# The signature that `iotcloud sign` has put beside it.
if [ "$1" = purge ]; then
  rm -f /usr/lib/iotcloud/plugins/{plugin}.so.sig
  rmdir --ignore-fail-on-non-empty /usr/lib/iotcloud/plugins /usr/lib/iotcloud 2>/dev/null || true
fi
#DEBHELPER#
""", encoding="utf-8")
    for part in OF_STORM:
        if (there / part).exists():
            with open(folder / "iotcloud-storm.install", "a", encoding="utf-8") as file:
                file.write(f"{part}\n")
    for page in sorted((there / "usr/share/man").rglob("*.[18]")):
        for package in kept:
            if f"usr/bin/{page.stem}" in taken_by(package.split()[1]):
                with open(folder / f"{package.split()[1]}.install", "a", encoding="utf-8") as file:
                    file.write(f"{page.relative_to(there)}\n")
    (folder / "changelog").write_text(f"""iotcloud ({version}) unstable; urgency=medium

  * What changed: CHANGELOG.md of this version, in the package iotcloud-doc.

 -- {name} <{address}>  {email.utils.formatdate(time_of_sources())}
""", encoding="utf-8")
    if is_part:
        with open(folder / "not-installed", "a", encoding="utf-8") as file:
            file.writelines(f"{path}\n" for path in installed)
    return [text.split()[1] for text in kept]


def make(build, out, version, components=(), fast=False):
    """Makes the packages in `out`, which has nothing else afterwards. Returns their files. What they are made of is beside it
    meanwhile, and stays when it fails."""
    work = out.parent / f"{out.name}-work"
    for folder in (work, out):
        shutil.rmtree(folder, ignore_errors=True)
    there = work / "installed"
    there.mkdir(parents=True)
    say(f"packages {version}: installing the build")
    install(build, there, components)
    say(f"packages {version}: manual pages and completions")
    manual_pages(there, version)
    completions(there)
    packages = write_debian(work / "iotcloud/debian", there, version, bool(components))
    say(f"packages {version}: debhelper makes {len(packages)} of them")
    environment = {**os.environ, "SOURCE_DATE_EPOCH": str(time_of_sources()), "PACKAGE_OPTIONS": "-Zxz -z0" if fast else "-Zxz",
                   "DEB_BUILD_OPTIONS": "nocheck"}
    with open(work / "debhelper.log", "w", encoding="utf-8") as log:
        done = subprocess.run(["dpkg-buildpackage", "--build=binary", "--unsigned-changes", "--no-pre-clean", "--no-check-builddeps",
                               "--jobs=auto"], cwd=work / "iotcloud", env=environment, stdout=log, stderr=subprocess.STDOUT, check=False)
    if done.returncode:
        said = (work / "debhelper.log").read_text(encoding="utf-8")
        raise Failed(f"{said[-4000:]}\ndebhelper failed; all it said is in {work}/debhelper.log")
    out.mkdir(parents=True)
    made = []
    for file in sorted(work.glob("*.deb")):
        made.append(out / file.name)
        file.rename(out / file.name)
    shutil.rmtree(work)
    return made


def lint(packages):
    """Raises Failed with what Lintian says, if that is an error or a warning."""
    done = subprocess.run(["lintian", "--fail-on", "error,warning", "--allow-root", *map(str, packages)], capture_output=True, text=True,
                          check=False)
    if done.returncode:
        raise Failed(f"lintian:\n{done.stdout}{done.stderr}")


def main():
    options = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    options.add_argument("--build", type=Path, default=ROOT / "build/release")
    options.add_argument("--out", type=Path, default=ROOT / "build/packages")
    options.add_argument("--version")
    options.add_argument("--components", nargs="*", default=[])
    options.add_argument("--no-lint", action="store_true")
    options.add_argument("--fast", action="store_true")
    given = options.parse_args()
    try:
        number = given.version or version_here()
        made = make(given.build.resolve(), given.out.resolve(), number, given.components, given.fast)
        say(f"packages {number}: an SBOM of each")
        sbom.of_packages(made, given.build.resolve(), time_of_sources())
        if not given.no_lint:
            say(f"packages {number}: lintian")
            lint(made)
    except Failed as error:
        sys.exit(f"./dev package: {error}")
    for file in made:
        print(f"{file.stat().st_size / 1e6:8.1f} MB  {os.path.relpath(file)}")


if __name__ == "__main__":
    main()
