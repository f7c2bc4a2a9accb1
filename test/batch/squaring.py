# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""What processes of the tests of the runner do."""
from __future__ import annotations

import os
import signal

from stereo_speed.core.errors import InputError


def work(parameters):
    """Jobs for the tests of the runner's processes."""
    if parameters.get('trace'):
        with open(parameters['trace'], 'a') as file:
            file.write(f'{parameters["n"]} {os.getpid()}\n')
    if parameters.get('fail'):
        raise ValueError(parameters['fail'])
    if parameters.get('refuse'):
        raise InputError('scene', 'lane', 7, 'below 3')
    if parameters.get('die'):
        os.kill(os.getpid(), signal.SIGKILL)
    return {'square': parameters['n'] ** 2}
