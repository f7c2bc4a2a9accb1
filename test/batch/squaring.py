# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The work of the jobs in the runner's tests, for worker processes."""
from __future__ import annotations

import os
import signal

from stereo_speed.core.errors import InputError


def work(parameters):
    """Square a number and record that it ran, or fail, as the parameters say."""
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
