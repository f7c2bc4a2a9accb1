#!/bin/bash
# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
# Usage: pythons.sh TESTS... Run tests, except slow ones, on every other Python that is available,
# installed or built by pyenv; on 3.12 with the versions of numpy, OpenCV and other libraries of
# Ubuntu 24.04, which a native ROS 2 Jazzy uses. Versions that are not available are skipped and
# listed; so are those that would start after ENOUGH_S seconds.
set -uo pipefail
cd "$(dirname "$0")/.."
export OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 OPENCV_FOR_THREADS_NUM=1
passed=() skipped=() failed=()
enough=${ENOUGH_S:-900}

at_hand() {  # at_hand VERSION: print an interpreter of it that runs
    local python
    for python in "python$1" "${PYENV_ROOT:-$HOME/.pyenv}/versions/$1".*/bin/python; do
        "$python" -c '' 2>/dev/null && command -v "$python" && return
    done
    return 1
}

tested() {  # tested NAME PYTHON VENV VERSIONS TESTS...
    local name=$1 interpreter=$2 venv=$3 versions=$4
    shift 4
    echo "== $name ($SECONDS s)"
    if ! bash tools/venv.sh "$interpreter" "$venv" "$versions"; then
        skipped+=("$name: a package cannot be had here")
    elif "$venv/bin/python" tools/as_pinned.py "$versions" &&
            "$venv/bin/python" tools/warm_up.py &&
            "$venv/bin/python" -m pytest -q -m 'not slow' -n auto --dist loadfile "$@"
    then passed+=("$name")
    else failed+=("$name")
    fi
}

for version in 3.12 3.10 3.13; do
    venv=.venv-$version versions=/dev/null
    [ $version = 3.12 ] && venv=.venv-noble versions=tools/noble.txt
    if [ $SECONDS -gt "$enough" ]; then
        skipped+=("Python $version: the others took long")
    elif python=$(at_hand $version); then
        tested "Python $version" "$python" "$venv" "$versions" "$@"
    else
        skipped+=("Python $version: not at hand")
    fi
done
echo "== $SECONDS s"
for name in "${passed[@]}"; do echo "passed: $name"; done
for name in "${skipped[@]}"; do echo "skipped: $name"; done
for name in "${failed[@]}"; do echo "failed: $name"; done
[ ${#failed[@]} -eq 0 ]
