#!/bin/bash
# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
# Usage: pythons.sh. The fast tests on each other Python that is at hand, and once with the versions
# of numpy, OpenCV and the rest that Ubuntu 24.04 has, which a native ROS 2 Jazzy runs on.
set -uo pipefail
cd "$(dirname "$0")/.."
failed=()
for version in 3.10 3.12 3.13; do
    python=python$version
    if ! "$python" -c '' 2>/dev/null; then
        echo "== $python is not at hand"
        continue
    fi
    echo "== $python"
    make test-fast PYTHON="$python" VENV=".venv-$version" || failed+=("$python")
done
if python3.12 -c '' 2>/dev/null; then
    echo '== python3.12 with the versions of Ubuntu 24.04'
    bash tools/venv.sh python3.12 .venv-noble &&
        .venv-noble/bin/python -m pip install --quiet --disable-pip-version-check \
            --requirement tools/noble.txt &&
        OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 OPENCV_FOR_THREADS_NUM=1 \
            .venv-noble/bin/python -m pytest -q -m 'not slow' -n auto --dist loadfile \
            --ignore=test/integration --ignore=test/cli --ignore=test/lab --ignore=test/nodes ||
        failed+=('Ubuntu 24.04')
fi
[ ${#failed[@]} -eq 0 ] || { echo "failed: ${failed[*]}" >&2; exit 1; }
