"""The project's files, for checks of all of them."""
import os
from pathlib import Path


def project_files(root):
    """The files below `root` in order, without those of builds and hidden folders. Passes over folders that something else
    removes meanwhile, which pathlib's rglob() does not."""
    found = []
    for folder, folders, files in os.walk(root):
        folders[:] = [name for name in folders if name != "build" and not name.startswith(".")]
        found += [Path(folder) / name for name in files]
    return sorted(path for path in found if path.is_file())
