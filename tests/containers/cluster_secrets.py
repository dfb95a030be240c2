"""The secrets of deploy/cluster, made on this machine by the code of `./dev cluster up`."""

import cluster


class OnThisMachine:
    """Runs what `cluster.py` would run in a container."""

    def __init__(self, iotcloud, folder):
        self.iotcloud, self.folder = iotcloud, folder

    def once(self, _, *words, entrypoint=""):
        here = [word.replace("/secrets", str(self.folder)) for word in words]
        return [entrypoint or str(self.iotcloud), *here]


def make(programs, folder):
    """A folder for each service, which is what its container sees as /run/secrets."""
    cluster.SECRETS = folder
    cluster.user_id = lambda: 0  # these daemons run as the test does
    cluster.make_secrets(OnThisMachine(programs / "iotcloud", folder.with_name("secrets.new") / "authority"))
