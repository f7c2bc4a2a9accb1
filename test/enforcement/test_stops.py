# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Writers stopped at random steps, with torn files, as in ``tamper``."""
from __future__ import annotations

import os
import signal
import time

import numpy as np
import pytest
from stereo_speed.core.errors import StereoSpeedError
from stereo_speed.enforcement.store import EvidenceStore
from stereo_speed.lab.evaluation.tamper import Outcome, stopped_writers


@pytest.fixture
def folder(tmp_path, small):
    """Return a folder with two small records."""
    with EvidenceStore(tmp_path / 'evidence') as store:
        for number in (1, 2):
            store.add(f'r{number}', *small(f'r{number}', number))
    return tmp_path / 'evidence'


@pytest.mark.slow
@pytest.mark.parametrize(('kill', 'damage'), [(True, 'writer killed'), (False, 'disk full')])
def test_each_stop_takes_effect_and_records_stay_whole(folder, kill, damage):
    found = stopped_writers(folder, 25, np.random.default_rng(1), kill=kill)
    assert found == Outcome(damage, 25, 0)


def crashes():
    raise RuntimeError('a fault of the writer')


def hangs():
    time.sleep(600.0)


def is_ended():
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # rclpy may have set another handler
    os.kill(os.getpid(), signal.SIGTERM)


@pytest.mark.parametrize(('act', 'patience_s', 'status'), [
    (crashes, 60.0, 1), (hangs, 0.3, None), (is_ended, 60.0, -signal.SIGTERM)])
@pytest.mark.parametrize('kill', [True, False])
def test_writer_that_ends_for_another_cause_is_no_stop(
        folder, monkeypatch, act, patience_s, status, kill):
    tester, real = os.getpid(), EvidenceStore.add

    def add(store, *args):
        if os.getpid() != tester:  # the writer that is to be stopped
            act()
        return real(store, *args)
    monkeypatch.setattr(EvidenceStore, 'add', add)
    with pytest.raises(StereoSpeedError, match=f'ended with {status}, not with'):
        stopped_writers(folder, 1, np.random.default_rng(1), kill=kill, patience_s=patience_s)
