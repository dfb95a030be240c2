"""The secured files of deploy/fleet, made by the commands of its page, with paths of a test."""

import re
import shutil
import subprocess

PLUGINS = "/usr/lib/iotcloud/plugins"
INSTALLED = "/usr/share/doc/iotcloud/fleet"


def replaced(text, paths):
    """`text` with each of the paths and ports replaced; one that is not there is an error."""
    for there, here in paths.items():
        if there not in text:
            raise ValueError(f"{there} is not in:\n{text}")
        text = text.replace(there, str(here))
    return text


def make(deploy, programs, plugin, folder):
    """Runs the page's commands in `folder`: then folder/etc is what is to be /etc/iotcloud, and folder/plugins has the signed
    plugin. `programs`: the folder of the command line."""
    installed, plugins = folder / "installed", folder / "plugins"
    shutil.copytree(deploy / "fleet", installed)
    shutil.copy(deploy / "systemd/registry-tunnel.conf", installed)
    plugins.mkdir()
    shutil.copy(plugin, plugins)
    page = (deploy / "fleet" / "README.md").read_text(encoding="utf-8").split("## Files")[0]
    script = replaced("\n".join(re.findall(r"```sh\n(.*?)```", page, re.DOTALL)), {PLUGINS: plugins, INSTALLED: installed})
    done = subprocess.run(["/bin/sh", "-e", "-c", script], cwd=folder, capture_output=True, text=True, timeout=120, check=False,
                          env={"PATH": f"{programs}:/usr/bin:/bin"})
    if done.returncode:
        raise RuntimeError(f"the page's commands fail: {done.stderr}")
