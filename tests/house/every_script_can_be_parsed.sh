#!/usr/bin/env bash
# The benchmarks' scripts run rarely: a merge that broke one would be noticed late.
set -euo pipefail
git ls-files '*.py' | xargs /usr/bin/python3 -c '
import ast, sys
for file in sys.argv[1:]:
    ast.parse(open(file, encoding="utf-8").read(), file)
print(len(sys.argv) - 1, "Python scripts")'
scripts=$(git grep -lE '^#!.*\bbash$')
for script in $scripts; do bash -n "$script"; done
echo "$(wc -w <<<"$scripts") shell scripts"
