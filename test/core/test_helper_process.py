# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A process that helps, where it cannot be had."""
from __future__ import annotations

import os

import pytest
from stereo_speed.core.helper_process import HelperProcess


def test_a_process_whose_priority_is_refused_is_ended_and_leaves_nothing_open(monkeypatch):
    began = []

    def refuse(which, pid, priority):
        began.append(pid)
        raise PermissionError('no')
    monkeypatch.setattr(os, 'setpriority', refuse)
    opened = len(os.listdir('/proc/self/fd'))
    with pytest.raises(PermissionError, match='no'):
        HelperProcess('stereo_speed.detection.search_process', 5.0, patience=1)
    with pytest.raises(ChildProcessError):  # it has ended, and its status was taken
        os.waitpid(began[0], os.WNOHANG)
    assert len(os.listdir('/proc/self/fd')) == opened
