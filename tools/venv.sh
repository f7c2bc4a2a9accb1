#!/bin/bash
# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
# Usage: venv.sh PYTHON FOLDER [VERSIONS]. Make the virtual environment from requirements.lock, or
# keep an existing one that matches the lock, the interpreter's version and this folder.
# Pins in the file VERSIONS replace those of the lock for the same packages.
set -euo pipefail
cd "$(dirname "$0")/.."
python=$1 venv=$2 versions=${3:-/dev/null}

fail() { echo "error: $1" >&2; exit 1; }

version=$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null) ||
    fail "$python does not run; give another one: make PYTHON=python3.12"
"$python" -c 'import sys; sys.exit(sys.version_info < (3, 10))' ||
    fail "$python is Python $version, 3.10 or newer is needed: make PYTHON=python3.12"

pins() {
    sed -n 's/==.*/==/; /==/s/^/^/p' "$versions" | grep --invert-match --file=- requirements.lock
    cat "$versions"
}
wanted() { echo "python $version at $PWD"; pins; }
is_made() { wanted | cmp -s - "$venv/stamp" && "$venv/bin/python" -c '' 2>/dev/null; }
is_made && exit 0
"$python" -c 'import ensurepip, venv' 2>/dev/null ||
    fail "$python has no venv with pip; on Debian and Ubuntu: apt-get install python3-venv"

# Two targets may be made at once; the second waits until the first has made the environment.
exec 9> "$venv.lock"
flock --nonblock 9 || {
    echo "waiting until another make has made $venv"
    flock --wait 900 9 || fail "another make has been making $venv for 15 minutes"
}
is_made && exit 0
echo "making $venv with Python $version (a minute or two)"
rm -rf "$venv"
"$python" -m venv "$venv"
pins > "$venv/pins.txt"
# No dependency resolution: the lock is complete, and VERSIONS may violate declared constraints.
"$venv/bin/python" -m pip install --quiet --disable-pip-version-check \
    --use-pep517 --no-deps --requirement "$venv/pins.txt"
# The checkout itself, so that the package imports from anywhere.
site=$("$venv/bin/python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')
echo "$PWD" > "$site/stereo_speed.pth"
wanted > "$venv/stamp"
