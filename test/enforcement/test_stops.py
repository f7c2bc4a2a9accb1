# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Writers of small records stopped at random steps, with files torn, as ``tamper`` does it."""
from __future__ import annotations

import numpy as np
import pytest
from stereo_speed.enforcement.store import EvidenceStore
from stereo_speed.lab.evaluation.tamper import Outcome, stopped_writers


@pytest.mark.slow
@pytest.mark.parametrize(('kill', 'damage'), [(True, 'writer killed'), (False, 'disk full')])
def test_each_stop_hits_and_none_leaves_half_a_record_or_loses_one(tmp_path, small, kill, damage):
    with EvidenceStore(tmp_path / 'evidence') as store:
        for number in (1, 2):
            store.add(f'r{number}', *small(f'r{number}', number))
    found = stopped_writers(tmp_path / 'evidence', 25, np.random.default_rng(1), kill=kill)
    assert found == Outcome(damage, 25, 0)
