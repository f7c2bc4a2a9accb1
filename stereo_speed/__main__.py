# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""``python -m stereo_speed COMMAND``."""
import sys

from .cli.main import main

if __name__ == '__main__':
    sys.exit(main())
