#!/usr/bin/python3
"""The SBOMs of packages and of the container image (development/sbom.py): PyPI's CycloneDX library finds that they keep to the standard,
and they have what is linked by dpkg-shlibdeps' own account, headers that are known to be compiled in, and npm's part of the console.

usage: sbom_test.py BUILD_DIR   (exit status 77: PyPI cannot be reached)
"""

import json
import re
import shutil
import subprocess
import sys
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SKIPPED = 77
VALIDATE = """
import sys
from cyclonedx.schema import SchemaVersion
from cyclonedx.validation.json import JsonStrictValidator
problems = 0
for name in sys.argv[1:]:
    problem = JsonStrictValidator(SchemaVersion.V1_5).validate_str(open(name, encoding="utf-8").read())
    if problem:
        problems += 1
        print(name, problem)
sys.exit(problems != 0)
"""
# Without a library of their own, and read by sources of the program: CMakeLists.txt and CONTRIBUTING.md say so.
COMPILED_IN = {"iotcloud": {"libcli11-dev", "nlohmann-json3-dev"}, "iotcloud-driver-http": {"libboost1.74-dev"},
               "iotcloud-dev": {"libfmt-dev"}, "iotcloud-master": {"nlohmann-json3-dev", "preact", "uplot", "@dagrejs/dagre"}}
LINKED = {"iotcloud-driver-mqtt": {"libmosquitto1"}, "iotcloud-driver-modbus": {"libmodbus5"}, "iotcloud-gateway": {"librdkafka1"}}


def run(*command):
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"wrong: {' '.join(map(str, command))}\n{done.stdout}{done.stderr}")
    return done.stdout


def require(condition, text):
    if not condition:
        sys.exit(f"wrong: {text}")


def validator(folder):
    """The Python that has PyPI's CycloneDX library, with the standard's schemas in it."""
    python = folder / "bin/python"
    if not python.exists():
        venv.create(folder, with_pip=True)
    done = subprocess.run([python, "-m", "pip", "install", "--quiet", "cyclonedx-python-lib[json-validation]==11.12.0"],
                          capture_output=True, text=True, check=False)
    if done.returncode:
        print(f"PyPI's CycloneDX library cannot be had here:\n{done.stderr}")
        sys.exit(SKIPPED)
    return python


def parts(document, how):
    """Versions of the components that are in it in this way, by their names."""
    return {part["name"]: part["version"] for part in document["components"]
            if {"name": "iotcloud:how", "value": how} in part.get("properties", [])}


def check_package(package, document):
    name = document["metadata"]["component"]["name"]
    linked, compiled = parts(document, "linked"), parts(document, "compiled in")
    needed = re.findall(r"(?:^|, )(lib[\w.+-]+)", run("dpkg-deb", "--field", package, "Depends")) if name != "iotcloud-dev" else []
    provided = set(re.findall(r"(lib[\w.+-]+)", run("dpkg-query", "-W", "-f=${Package} ${Provides}\n", *linked))) if linked else set()
    require(set(needed) <= provided, f"{name} needs {needed}, and its SBOM has {sorted(linked)}")
    require(LINKED.get(name, set()) <= set(linked), f"{name} has {sorted(linked)}")
    require(COMPILED_IN.get(name, set()) <= set(compiled), f"{name} has compiled in {sorted(compiled)}")
    for library, version in linked.items():
        require(run("dpkg-query", "-W", "-f=${Version}", library) == version, f"{name}: {library} {version} is not installed here")


def check_image(work, packages):
    """Of an image whose base has libc6, and which got a copy of one library."""
    [library] = Path("/usr/lib").glob("*-linux-gnu/libyaml-cpp.so.0.7")
    files = work / "files"
    (files / library.relative_to("/")).parent.mkdir(parents=True)
    shutil.copy(library, files / library.relative_to("/"))
    (work / "status").write_text("Package: libc6\nStatus: install ok installed\n\nPackage: gone\nStatus: deinstall ok config-files\n",
                                 encoding="utf-8")
    file = work / "image.cdx.json"
    run("/usr/bin/python3", ROOT / "development/sbom.py", "image", "--name", "iotcloud", "--version", "0.1.0", "--own", packages,
        "--base", work / "status", "--files", files, file)
    document = json.loads(file.read_text(encoding="utf-8"))
    require(set(parts(document, "installed")) == {"libc6", "libyaml-cpp0.7"}, sorted(parts(document, "installed")))
    names = {part["name"] for part in document["components"]}
    require({"iotcloud-gateway", "libcli11-dev", "preact"} <= names and not {"gone", "iotcloud-doc"} & names, sorted(names))
    return file


def main():
    build = Path(sys.argv[1]).resolve()
    work = build / "sbom_test"
    python = validator(build / "sbom_python")
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir()
    run("/usr/bin/python3", ROOT / "development/package.py", "--build", build, "--out", work / "packages", "--fast", "--no-lint")
    packages = sorted((work / "packages").glob("*.deb"))
    files = [package.with_suffix(".cdx.json") for package in packages]
    for package, file in zip(packages, files):
        check_package(package, json.loads(file.read_text(encoding="utf-8")))
    files.append(check_image(work, work / "packages"))
    print(run(python, "-c", VALIDATE, *files))
    # The validator refuses what the standard does.
    wrong = json.loads(files[0].read_text(encoding="utf-8"))
    wrong["metadata"]["component"]["type"] = "thing"
    (work / "wrong.json").write_text(json.dumps(wrong), encoding="utf-8")
    done = subprocess.run([python, "-c", VALIDATE, work / "wrong.json"], capture_output=True, text=True, check=False)
    require(done.returncode == 1 and "thing" in done.stdout, f"a wrong file is taken: {done}")
    print(f"{len(files)} SBOMs")


if __name__ == "__main__":
    main()
