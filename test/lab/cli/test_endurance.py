# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Repeated bags, and the tables of their cost."""
from __future__ import annotations

import pytest
from stereo_speed.cli.main import main
from stereo_speed.core.errors import InputError
from stereo_speed.io.bags import StereoBag
from stereo_speed.lab.sim.repeat import repeat_bag


def test_looping_bag_has_increasing_stamps(sample, tmp_path):
    folder = repeat_bag(sample / 'bag', tmp_path / 'bag', 3, 8.0, pairs=2)
    with StereoBag(folder) as bag:
        stamps = [pair.stamp_ns for pair in bag.pairs()]
    # Two pairs 0.2 s apart, thrice, with 8 s between.
    steps = [(b - a) / 1e9 for a, b in zip(stamps, stamps[1:])]
    assert steps == pytest.approx([0.2, 8.0, 0.2, 8.0, 0.2])
    with pytest.raises(InputError, match='a new one'):
        repeat_bag(sample / 'bag', folder, 1, 8.0)


@pytest.mark.slow
def test_tables_of_the_costs_of_bags(tmp_path, capsys):
    assert main(['endurance', 'many', '--bags', '1', '--jobs', '0', '--out', str(tmp_path)]) == 0
    row = capsys.readouterr().out.splitlines()[-2].strip('| ').split(' | ')
    assert row[:2] == ['1', '1']
    # A process that has measured a bag uses about 100 MB and some time.
    assert float(row[2]) > 0 and 50 < float(row[4]) < 4000
    assert float(row[5]) <= float(row[2])
