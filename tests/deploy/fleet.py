"""The secured files of deploy/fleet, made by the commands of its page, with paths of a test."""

import re
import shlex
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


def blocks(text):
    """The blocks of commands in a page."""
    return re.findall(r"```sh\n(.*?)```", text, re.DOTALL)


def page(deploy):
    """The page before and after its section "Files"."""
    return (deploy / "fleet" / "README.md").read_text(encoding="utf-8").split("## Files")


def make(deploy, programs, plugin, folder):
    """Runs the page's commands in `folder`: then folder/etc is what is to be /etc/iotcloud, folder/lab2 what is to be that of a
    further machine, and folder/plugins has the signed plugin. `programs`: the folder of the command line. rabbitmqctl is one that
    keeps what it is told (told_rabbitmq())."""
    installed, plugins = folder / "installed", folder / "plugins"
    shutil.copytree(deploy / "fleet", installed)
    shutil.copy(deploy / "systemd/registry-tunnel.conf", installed)
    plugins.mkdir()
    shutil.copy(plugin, plugins)
    script = replaced("\n".join(blocks(page(deploy)[0])), {PLUGINS: plugins, INSTALLED: installed})
    run(script, programs, folder)


def submitted(topology, workers):
    """The page's topology as one to submit: with the files of the folder for workers, and any port. Its pool watches the tunnel."""
    topology = re.sub(r" *certificates: .*\n", "", topology)
    text = re.sub(r"/etc/iotcloud/(lab1-topology\.)?", lambda found: f"{workers}/{'host.' if found[1] else ''}", topology)
    return replaced(text, {"0.0.0.0:9406": "0.0.0.0:0"})


def run(script, programs, folder):
    """Runs commands of the page in `folder`."""
    own = folder / "bin"
    own.mkdir(exist_ok=True)
    (own / "rabbitmqctl").write_text(f"""#!/bin/sh
for word in "$@" "$(case $1 in add_user|change_password) cat;; esac)"; do printf '%s\\0' "$word"; done >> {shlex.quote(str(folder / 'rabbitmq'))}
printf '\\n' >> {shlex.quote(str(folder / 'rabbitmq'))}
""")
    (own / "rabbitmqctl").chmod(0o755)
    done = subprocess.run(["/bin/sh", "-e", "-c", script], cwd=folder, capture_output=True, text=True, timeout=300, check=False,
                          env={"PATH": f"{own}:{programs}:/usr/bin:/bin"})
    if done.returncode:
        raise RuntimeError(f"the page's commands fail: {done.stderr}")


def told_rabbitmq(folder):
    """The words of each call of rabbitmqctl; the last one is what it read, a user's new password."""
    return [line.split("\0")[:-1] for line in (folder / "rabbitmq").read_text(encoding="utf-8").splitlines()]
