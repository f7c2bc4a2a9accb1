# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""What the benchmark tells: each job counts after its first run, and every kernel is there."""
from __future__ import annotations

import sys

import pytest

from stereo_speed.lab.evaluation import benchmarks
from stereo_speed.lab.evaluation.benchmarks import filter_table, kernel_table, medians
from stereo_speed.report.comparison import growth_plot


def test_jobs_take_turns_and_their_first_run_does_not_count(monkeypatch):
    order = []
    clock = iter([0, 1, 10, 15, 20, 23, 30, 37, 40, 42, 50, 56])  # s, before and after each call
    monkeypatch.setattr(benchmarks.time, 'process_time', lambda: next(clock))
    found = medians({name: lambda name=name: order.append(name) for name in 'ab'}, 3)
    assert order == list('ab' * 4)
    assert found == {'a': 2000.0, 'b': 6000.0}


def test_kernels_are_timed_compiled_and_plain():
    pytest.importorskip('numba')
    table = kernel_table(1)
    assert {str(row[0]).rpartition('.')[2] for row in table.rows} == {
        '_temporal', '_cross', 'views', 'shifted', 'mirrored', 'edges'}
    assert all(plain > 0 and ratio > 0 for _, plain, _, ratio in table.rows)


def test_the_filter_is_timed_without_a_peer_too(monkeypatch):
    monkeypatch.setitem(sys.modules, 'filterpy.monte_carlo', None)
    table = filter_table(1)
    assert [row[2] for row in table.rows] == ['not installed'] * 4
    assert all(row[1] > 0 for row in table.rows)


def test_the_plot_is_a_picture(tmp_path):
    growth_plot(tmp_path / 'a.png', {'tracks': [(1, 2.0), (2, 4.0)]}, 'tracks')
    assert (tmp_path / 'a.png').read_bytes().startswith(b'\x89PNG')
