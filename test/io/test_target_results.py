# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The folder of a run of the monocular tracker, byte for byte."""
import json
import math

import pytest

from stereo_speed.core.errors import InputError
from stereo_speed.io.mot import boxes_text
from stereo_speed.io.target_results import ends_text, targets_text, write_targets
from stereo_speed.monocular.boxes import TargetEnd, TargetState


def test_targets_csv_is_written_exactly(estimate):
    text = targets_text([estimate(3, distance_px=math.inf),
                         estimate(2, angle_rad=math.pi / 6)])
    assert text == ('frame,id,x,y,w,h,angle_deg,d_px,d_rate_px\n'
                    '2,1,1.000,2.000,3.000,4.000,30.000,-2.500,0.000\n'
                    '3,1,1.000,2.000,3.000,4.000,0.000,inf,0.000\n')


def test_ends_are_written_exactly():
    ends = [TargetEnd(id=9, first_frame=2, last_frame=8, frames=3, state=TargetState.LOST),
            TargetEnd(id=1, first_frame=1, last_frame=5, frames=5, state=TargetState.LEFT_VIEW)]
    assert ends_text(ends) == ('id,first_frame,last_frame,frames,end\n1,1,5,5,left_view\n'
                               '9,2,8,3,lost\n')


def test_folder_of_a_run(tmp_path, estimate):
    out = tmp_path / 'out'
    out.mkdir()
    (out / 'summary.json').write_text('old')
    (out / 'annotated.avi').write_text('of an older run')
    (out / 'photo.png').write_text('mine')
    end = TargetEnd(id=1, first_frame=1, last_frame=2, frames=2, state=TargetState.STREAM_ENDED)
    write_targets(out, [estimate(2), estimate(1)], [end], {'seed': 3})
    assert sorted(p.name for p in out.iterdir()) == [
        'boxes.txt', 'ends.csv', 'photo.png', 'summary.json', 'targets.csv']
    assert (out / 'boxes.txt').read_text() == boxes_text([estimate(1), estimate(2)])
    assert (out / 'targets.csv').read_text() == targets_text([estimate(1), estimate(2)])
    assert (out / 'ends.csv').read_text() == ends_text([end])
    assert json.loads((out / 'summary.json').read_text())['seed'] == 3
    (tmp_path / 'video').write_text('of this run')
    write_targets(out, [estimate(2)], [end], {'seed': 4}, tmp_path / 'video')
    assert (out / 'annotated.avi').read_text() == 'of this run'
    assert not (tmp_path / 'video').exists()
    with pytest.raises(InputError, match='photo.png: output folder'):
        write_targets(out / 'photo.png', [], [], {})
