# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The fuzzer's judge detects each kind of wrong behaviour."""
from __future__ import annotations

import os
import sys
import warnings

import numpy as np
import pytest
from stereo_speed.core.errors import InputError
from stereo_speed.lab.cli import fuzz_judge


def refuse(text):
    raise InputError('file', 'field', text, 'something else')


def fail():
    return [][1]


def chatter():
    os.write(2, b'Corrupt JPEG data\n')


def hog():
    np.ones(150 * 2 ** 20, np.uint8)


def loop():
    while True:
        pass


def warn():
    warnings.warn('overflow', RuntimeWarning)


def twice():
    print('error: one\nerror: two', file=sys.stderr)
    return 2


@pytest.mark.parametrize(('call', 'fault'), [
    (lambda: refuse('x'), ''), (lambda: None, ''), (lambda: 0, ''),
    (lambda: 1 / 0, 'ZeroDivision'),
    (fail, 'IndexError'), (chatter, 'Corrupt JPEG'), (hog, 'MB'), (loop, 'more than'),
    (warn, 'warned: overflow'), (twice, 'error: two'),
    (lambda: 'a reading from garbage', 'garbage'),
], ids=lambda value: getattr(value, '__name__', ''))
def test_judge_finds_faults(call, fault, tmp_path, monkeypatch):
    if call is loop:
        monkeypatch.setattr(fuzz_judge, 'MOST_S', 0.3)
    monkeypatch.setattr(fuzz_judge, 'MOST_MB', 100)
    found = fuzz_judge.judge('x', call, tmp_path)
    assert fault in found.fault
    assert bool(fault) == bool(found.fault)
