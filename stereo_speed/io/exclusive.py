# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Files that only one run at a time may write."""
from __future__ import annotations

import fcntl
from pathlib import Path
from typing import TextIO

from ..core.errors import InputError


def open_alone(path: Path, what: str) -> TextIO:
    """
    Open a text file for reading and appending, with an exclusive lock.

    :param what: what the file is, for errors.
    :raises InputError: another run has it open.
    """
    file = path.open('a+', encoding='utf-8')
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        file.close()
        raise InputError(path, what, 'another run that is writing it',
                         'a folder for each run') from None
    return file
