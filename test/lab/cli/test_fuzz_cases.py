# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Damaged input is refused in one line or accepted."""
from __future__ import annotations

import numpy as np
import pytest
from stereo_speed.lab.cli import fuzz_cases as fuzz
from stereo_speed.lab.cli.fuzz_judge import judge, Outcome
from stereo_speed.lab.sim.damage import damage_mcap, damage_value, MAGIC, split_records


@pytest.mark.parametrize('part', range(5))
def test_damaged_input_is_at_worst_refused(part, tmp_path):
    """About 300 cases for all readers; whole commands have separate tests."""
    result = fuzz.work({'seed': 7, 'first': 62 * part, 'count': 62})
    assert result['faults'] == []
    assert sum(map(sum, result['counts'].values())) == 62


@pytest.mark.parametrize('name', ['MCAP bag', 'SQLite bag', 'ROS 1 bag', 'video file', 'boxes',
                                  'site file', 'polygons file', 'targets file', 'parameter file'])
def test_undamaged_input_is_accepted(name, tmp_path, monkeypatch):
    for damage in ('damage_bytes', 'damage_value', 'damage_mcap'):
        monkeypatch.setattr(fuzz, damage, lambda rng, data: data)
    call = fuzz.SUBJECTS[name](np.random.default_rng(0), tmp_path)
    assert judge(name, call, tmp_path) == Outcome(name, False)


def test_damaged_evidence_is_found_and_reported_in_one_line(tmp_path):
    """Verified, recomputed or disclosed; undamaged folders verify."""
    case = fuzz.SUBJECTS['evidence folder']
    for number in range(12):
        folder = tmp_path / str(number)
        folder.mkdir()
        call = case(np.random.default_rng([3, number]), folder)
        assert judge('evidence folder', call, folder).fault == ''


def test_case_is_reproducible(tmp_path):
    for number in (2, 10, 61):
        folders = [tmp_path / f'{number}{k}' for k in 'ab']
        for folder in folders:
            folder.mkdir()
            fuzz.SUBJECTS['site file'](np.random.default_rng([0, number]), folder)
        assert (folders[0] / 'site.yaml').read_bytes() == (folders[1] / 'site.yaml').read_bytes()


def test_damage_to_an_mcap_file_keeps_its_frame():
    files = dict(fuzz._tiny_bag('mcap'))
    data, = (content for name, content in files.items() if name.endswith('.mcap'))
    records = split_records(data)
    assert {0x01, 0x03, 0x04, 0x06, 0x0f, 0x02} <= {code for code, _ in records}
    hurt = [damage_mcap(np.random.default_rng(k), data) for k in range(40)]
    assert all(h.startswith(MAGIC) and h.endswith(MAGIC) for h in hurt)
    assert sum(h != data for h in hurt) >= 38
    assert damage_mcap(np.random.default_rng(0), b'no bag at all') is not None


def test_damaging_values_does_not_change_the_original():
    tree = {'a': [1, {'b': 2}], 'c': 'd'}
    made = [damage_value(np.random.default_rng(k), tree) for k in range(50)]
    assert tree == {'a': [1, {'b': 2}], 'c': 'd'}
    assert sum(repr(m) != repr(tree) for m in made) == 50
