#!/bin/bash
# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
# Usage: pythons.sh. The fast tests on each other Python that is at hand, installed or made by
# pyenv, and once with the versions of numpy, OpenCV and the rest that Ubuntu 24.04 has, which a
# native ROS 2 Jazzy runs on.
set -uo pipefail
cd "$(dirname "$0")/.."
failed=()

at_hand() {  # at_hand VERSION: print an interpreter of it that runs
    local python
    for python in "python$1" "${PYENV_ROOT:-$HOME/.pyenv}/versions/$1".*/bin/python; do
        "$python" -c '' 2>/dev/null && command -v "$python" && return
    done
    return 1
}

fast() {  # fast VENV
    make --no-print-directory test-fast PYTHON="$python" VENV="$1" || failed+=("$2")
}

for version in 3.10 3.13 3.12; do
    python=$(at_hand $version) || { echo "== no Python $version at hand"; continue; }
    echo "== $python"
    fast ".venv-$version" "Python $version"
done
if [ -n "$python" ]; then
    echo "== $python with the versions of Ubuntu 24.04"
    noble=.venv-3.12/bin/python
    # What it installs is not what the stamp says: the environment is made anew the next time.
    rm -f ".venv-3.12/stamp"
    "$noble" -m pip install --quiet --disable-pip-version-check --requirement tools/noble.txt &&
        OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 OPENCV_FOR_THREADS_NUM=1 \
            "$noble" -m pytest -q -m 'not slow' -n auto --dist loadfile \
            --ignore=test/integration --ignore=test/cli --ignore=test/lab --ignore=test/nodes ||
        failed+=('Ubuntu 24.04')
fi
[ ${#failed[@]} -eq 0 ] || { echo "failed: ${failed[*]}" >&2; exit 1; }
