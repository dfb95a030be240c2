#!/usr/bin/python3
"""Subjects of new commits have at most 72 characters (CONTRIBUTING.md). New are those since the branch left the upstream's main,
or else the last one; in a clone with a part of the history, those of them that are there. Merges are left out: their subjects
name branches.

usage: check_subjects.py ROOT     (exit status 1 and a line for each violation)
"""

import subprocess
import sys

LONGEST = 72


def check(root):
    def git(*words, check=True):
        return subprocess.run(["git", "-C", root, *words], stdout=subprocess.PIPE, text=True, check=check,
                              stderr=None if check else subprocess.DEVNULL).stdout.strip()

    head = git("rev-parse", "HEAD")
    base = git("merge-base", "HEAD", "origin/main", check=False)
    new = ["-1", head] if base in ("", head) else [f"{base}..{head}"]
    for line in git("log", "--no-merges", "--format=%h %s", *new).splitlines():
        commit, _, subject = line.partition(" ")
        if len(subject) > LONGEST:
            yield (f"{commit}: {len(subject)} characters: {subject!r}; say in at most {LONGEST} what changed, and why in the body "
                   f"(git commit --amend, or git rebase --interactive)")


if __name__ == "__main__":
    found = list(check(sys.argv[1]))
    print("\n".join(found) or f"no new commit has a subject of more than {LONGEST} characters")
    sys.exit(1 if found else 0)
