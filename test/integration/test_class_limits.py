# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""From a bag to a record: the limit of the vehicle's lane and class applies."""
from __future__ import annotations

import json

import pytest
from stereo_speed.cli.main import main
from stereo_speed.enforcement.verify import verify
import yaml

SURE, IN_DOUBT = 0.95, 0.9999  # the sample's vehicle is a car with a probability between


@pytest.mark.slow
@pytest.mark.parametrize(('lanes', 'least', 'limit'), [
    ([{'car': '80 km/h', 'heavy_vehicle': '60 km/h'}, {'car': '120 km/h'}], SURE, 80),
    ([{'car': '90 km/h', 'heavy_vehicle': '60 km/h'}, {'car': '50 km/h'}], SURE, None),
    ([{'car': '70 km/h', 'heavy_vehicle': '90 km/h'}, {}], IN_DOUBT, None),
    ([{'car': '70 km/h', 'heavy_vehicle': '80 km/h'}, {}], IN_DOUBT, 80),
], ids=['of its class', 'its class may drive faster', 'in doubt, the greatest: none',
        'in doubt, the greatest: a record'])
def test_from_bag_to_record(sample, tmp_path, lanes, least, limit):
    """55 mph are 88 km/h; less 3 km/h they are above 80 km/h, and not above 90 km/h."""
    site = yaml.safe_load((sample / 'site.yaml').read_text())
    for lane, limits in zip(site['lanes'], lanes):
        lane['class_limits'] = limits
    (tmp_path / 'site.yaml').write_text(yaml.safe_dump(site))
    (tmp_path / 'config.yaml').write_text(yaml.safe_dump(
        {'enforcement': {'decision': {'least_class_probability': least}}}))
    out = tmp_path / 'out'
    assert main(['replay', str(sample / 'bag'), '--site', str(tmp_path / 'site.yaml'), '--config',
                 str(tmp_path / 'config.yaml'), '--out', str(out), '--no-plots',
                 '--evidence']) == 0
    records = [json.loads(path.read_text()) for path in out.glob('evidence/*/record.json')]
    counted = json.loads((out / 'summary.json').read_text())['enforcement']
    if limit is None:
        assert not records and counted['no_record'] == {'below_limit': 1}
        return
    record, = records
    assert record['vehicle']['class'] == 'car'
    assert SURE < record['vehicle']['class_probability'] < IN_DOUBT
    assert (record['speed']['limit'], record['speed']['considered']) == (limit, 85)
    assert record['place']['lane'] == 'lane_0'
    assert verify(out / 'evidence').sound
