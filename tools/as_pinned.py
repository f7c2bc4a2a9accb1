# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Check that this interpreter has the versions that a file pins, and print its versions.

Usage: as_pinned.py FILE, with a line NAME==VERSION for each package.
"""
from __future__ import annotations

from importlib.metadata import version
from pathlib import Path
import platform
import sys

import cv2
import numpy


def main(path: str) -> int:
    """Print the installed versions; return 1 where they differ from the pins."""
    lines = Path(path).read_text(encoding='utf-8').splitlines()
    pins = [line.strip().split('==') for line in lines if '==' in line]
    wrong = [f'{name} is {version(name)}, not {wanted}' for name, wanted in pins
             if version(name) != wanted]
    print(f'Python {platform.python_version()}, numpy {numpy.__version__}, '
          f'OpenCV {cv2.__version__}')
    for line in wrong:
        print(line, file=sys.stderr)
    return 1 if wrong else 0


if __name__ == '__main__':
    raise SystemExit(main(sys.argv[1]))
