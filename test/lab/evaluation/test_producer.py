# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Items from another process: the same, in order, with its exceptions."""
from __future__ import annotations

import importlib
import multiprocessing
from pathlib import Path
import signal

import pytest
from stereo_speed.lab.evaluation import producer
from stereo_speed.lab.evaluation.producer import produced, WAITING


@pytest.fixture
def squares(monkeypatch):
    """Return the function from a module that other processes can import."""
    monkeypatch.syspath_prepend(str(Path(__file__).parent))
    return importlib.import_module('producing').squares


def test_more_items_than_the_buffer_holds_come_in_order(squares):
    count = 3 * WAITING
    assert list(produced(squares, count)) == [n ** 2 for n in range(count)]


def test_error_in_the_process_is_raised_after_the_good_items(squares):
    items = produced(squares, 5, 2)
    assert [next(items), next(items)] == [0, 1]
    with pytest.raises(ValueError, match='no square of 2'):
        next(items)


@pytest.mark.slow
def test_dead_process_is_noticed(squares):
    with pytest.raises(RuntimeError, match='exit code -9'):
        list(produced(squares, 5, None, 1))


@pytest.mark.parametrize('ending', [signal.SIG_DFL, signal.SIG_IGN])
def test_process_ends_with_its_reader(squares, monkeypatch, ending):
    """Even if it ignores the request to end, like its reader."""
    monkeypatch.setattr(producer, '_ALIVE_S', 0.5)
    before = set(multiprocessing.active_children())
    handler = signal.signal(signal.SIGTERM, ending)
    try:
        items = produced(squares, 100 * WAITING)
        next(items)
    finally:
        signal.signal(signal.SIGTERM, handler)
    assert set(multiprocessing.active_children()) - before
    items.close()
    assert not set(multiprocessing.active_children()) - before
