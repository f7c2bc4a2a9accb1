# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""From a pass to a record: its content, its recomputation, and passes without a record."""
from __future__ import annotations

from dataclasses import fields, replace
from datetime import date
from functools import cache
import json
from pathlib import Path

import cv2
import jsonschema
import numpy as np
import pytest
from stereo_speed.core.errors import InputError
from stereo_speed.core.records import TrackUpdate
from stereo_speed.core.units import KMH_MPS, SpeedUnit
from stereo_speed.enforcement.config import (
    DecisionConfig, EnforcementConfig, EvidenceConfig, load_enforcement_config)
from stereo_speed.enforcement.decision import decide
from stereo_speed.enforcement.disclose import disclose
from stereo_speed.enforcement.fingerprint import Approved, load_approved, software_fingerprint
from stereo_speed.enforcement.instrument import Instrument
from stereo_speed.enforcement.recompute import recompute
from stereo_speed.enforcement.record import record_files, Violation
from stereo_speed.enforcement.ring import ImageRing
from stereo_speed.enforcement.verify import verify
from stereo_speed.io.bags import StereoBag
from stereo_speed.io.source_image import SourceImage
from stereo_speed.pipeline.assembly import MeasuringSite
from stereo_speed.pipeline.config import PipelineConfig
from stereo_speed.report.evidence_pictures import speed_plot
from stereo_speed.site.file import load_site

from .conftest import NAME, SAMPLE

TRUE_MPS = 55 * 0.44704


def record_of(folder):
    """Return the content of the record in a folder of records."""
    return json.loads((folder / NAME / 'record.json').read_text())


def test_record_states_result_place_time_and_instrument(written, sample):
    record = record_of(written)
    jsonschema.validate(record, json.loads(
        (written / NAME / 'record.schema.json').read_text()))
    speed = record['speed']
    assert abs(speed['measured_mps'] - TRUE_MPS) < 4 * speed['measured_std_mps']
    assert (speed['measured'], speed['considered'], speed['unit']) == (88, 85, 'km/h')
    assert speed['limit_mps'] == pytest.approx(45 * 0.44704)
    assert record['place']['lane'] == 'lane_0' and record['direction'] == 'approaching'
    assert record['time']['first_stamp_ns'] == sample.result.first_ns
    assert record['time']['first_utc'].endswith('Z')
    assert record['parameters']['measuring']['parameters']['particles'] == 400
    assert record['parameters']['enforcement']['decision']['tolerance_kmh'] == 3.0
    assert record['instrument']['fingerprints']['software'] == software_fingerprint()
    assert record['instrument']['approved'] == 'not asked'
    assert len(speed['profile']) == len(sample.result.trace.pairs)
    assert len({p['stamp_ns'] for p in record['pictures']}) == 3


@pytest.mark.slow
@pytest.mark.parametrize(('passed', 'shown'), [
    (None, 'none required'),
    ({'passed_utc': '2026-11-22T10:00:00Z', 'off_percent': -0.31},
     'passed 2026-11-22T10:00:00Z, -0.31 % off')])
def test_record_states_time_and_deviation_of_the_last_self_test(sample, passed, shown):
    told = replace(sample.setting.instrument, self_test=passed).text()  # as on its topic
    setting = replace(sample.setting, instrument=Instrument.of_text(told, 'instrument'))
    trace = sample.result.trace
    limit = sample.setting.place.site.lanes[0].speed_limit_mps
    figures, _ = decide(sample.result, limit, DecisionConfig())
    images = [(sample.ring.get('left', pair.stamp_ns),
               sample.ring.get('right', pair.right_image_ns)) for pair in trace.pairs]
    files, data = record_files(Violation(NAME, sample.result, trace, figures, images), 1, setting,
                               whole=False)
    assert json.loads(data)['instrument']['self_test'] == passed
    assert f'<td>self-test</td><td>{shown}</td>' in files['page.html'].decode()


@pytest.mark.parametrize('change', [
    {'self_test': wrong} for wrong in (
        3, 'passed', [], {}, {'passed_utc': 'now'}, {'passed_utc': 5, 'off_percent': None},
        {'passed_utc': 'now', 'off_percent': '0.2'}, {'passed_utc': 'now', 'off_percent': np.nan},
        {'passed_utc': 'now', 'off_percent': None, 'more': 1})
] + [{'run': 3}, {'versions': 'new'}, {'calibration': None}, {'site_yaml': ['a']}])
def test_instrument_with_a_field_of_another_type_is_refused(sample, change):
    told = {**json.loads(sample.setting.instrument.text()), **change}
    with pytest.raises(InputError, match='wanted the state of an instrument as JSON'):
        Instrument.of_text(json.dumps(told), 'instrument')


def test_originals_are_unchanged_with_marked_copies_beside_them(written, sample):
    folder, record = written / NAME, record_of(written)
    for picture in record['pictures']:
        for side in ('left', 'right'):
            image = sample.ring.get(side, picture['stamp_ns'])
            assert (folder / picture[side]).read_bytes() == image.data
            plain, marked = (cv2.imread(str(folder / picture[key])).astype(int)
                             for key in (side, f'{side}_marked'))
            corner = np.round(picture[f'{side}_front_px'][0]).astype(int)
            assert np.abs(plain - marked)[corner[1], corner[0]].max() > 20
    for page, start in (('page.html', b'<!DOCTYPE'), ('page.pdf', b'%PDF')):
        assert (folder / page).read_bytes().startswith(start)
    text = (folder / 'page.html').read_text()
    assert '85 km/h' in text and 'src="data:image/jpeg' in text and NAME in text


@pytest.mark.slow
def test_speed_is_recomputed_from_the_folder_alone(written):
    again = recompute(written / NAME)
    assert again.agrees and again.speed_mps == pytest.approx(again.stored_mps, abs=1e-9)
    assert record_of(written)['raw']['kind'] == 'crops'


@pytest.mark.slow
def test_recomputation_from_other_images_gives_another_speed(evidence):
    """With one pair's images replaced by another's the recomputation differs."""
    raw = evidence / NAME / 'raw'
    for side in ('left', 'right'):
        image = cv2.imread(str(raw / f'0005_{side}.png'), cv2.IMREAD_GRAYSCALE)
        cv2.imwrite(str(raw / f'0005_{side}.png'), np.roll(image, 3, axis=1))
    again = recompute(evidence / NAME)
    assert again.speed_mps is None or abs(again.speed_mps - again.stored_mps) > 2e-5


@pytest.mark.slow
def test_whole_images_are_kept_where_crops_are_too_small(sample, tmp_path):
    config = EnforcementConfig(evidence=EvidenceConfig(crop_margin=0.0))
    recorder = sample.recorder(tmp_path, config)
    tight = replace(config.evidence, most_recompute_mps=0.0)
    recorder.setting = replace(recorder.setting, config=replace(config, evidence=tight))
    assert recorder.offer(NAME, sample.result).anew
    assert record_of(tmp_path)['raw']['kind'] == 'whole'
    recorder.store.close()
    assert verify(tmp_path).sound


def frozen(sample):
    """Return a ring in which the right camera has repeated an image during the pass."""
    ring, (first, second) = ImageRing(1 << 30, 10 ** 12), sample.result.trace.pairs[3:5]
    for pair in sample.result.trace.pairs:
        ring.add('left', pair.stamp_ns, sample.ring.get('left', pair.stamp_ns))
        shown = first if pair is second else pair
        ring.add('right', pair.right_image_ns, sample.ring.get('right', shown.right_image_ns))
    return ring


@pytest.mark.parametrize(('change', 'counted'), [
    (lambda s: (s._replace(ring=frozen(s)), s.result), 'images_repeated'),
    (lambda s: (s, replace(s.result, trace=None)), 'not_traced'),
    (lambda s: (s._replace(ring=ImageRing(1, 1)), s.result), 'images_missing'),
    (lambda s: (s, replace(s.result, lane='nowhere')), 'no_limit'),
    (lambda s: (s, s.result.rejected('too_far')), 'not_measured'),
    pytest.param(lambda s: (s, replace(s.result, speed_mps=23.0, second=replace(
        s.result.second, speed_mps=23.0))), 'not_reproducible', marks=pytest.mark.slow),
], ids=['frozen', 'no trace', 'no images', 'no limit', 'rejected', 'wrong speed'])
def test_reasons_are_counted_and_no_files_remain(sample, tmp_path, change, counted):
    changed, result = change(sample)
    recorder = changed.recorder(tmp_path)
    assert recorder.offer(NAME, result) is None
    assert recorder.summary() == {'records': 0, 'no_record': {counted: 1}}
    recorder.store.close()
    assert verify(tmp_path).records == 0 and not list(tmp_path.glob('*run*'))


def test_pass_received_twice_is_one_record(sample, written, evidence):
    recorder = sample.recorder(evidence)
    stored = recorder.offer(NAME, sample.result)
    assert not stored.anew and recorder.summary()['records'] == 0
    recorder.store.close()
    assert {p.name: p.read_bytes() for p in evidence.rglob('*') if p.is_file()} == {
        p.name: p.read_bytes() for p in written.rglob('*') if p.is_file()}


@pytest.mark.slow
def test_unapproved_measurement_is_marked_or_refused(sample, tmp_path):
    path = tmp_path / 'approved.yaml'
    path.write_text('stereo_speed_approved: 1\nsoftware: [' + 'f' * 64 + ']\nsite: ['
                    + sample.setting.instrument.fingerprints['site'] + ']\n')
    approved = load_approved(path)
    assert approved.unknown(sample.setting.instrument.fingerprints) == ['software']
    refusing = EnforcementConfig(evidence=EvidenceConfig(unapproved='refuse'))
    recorder = sample.recorder(tmp_path / 'refused', refusing, approved)
    assert recorder.offer(NAME, sample.result) is None
    assert recorder.refused == {'not_approved': 1}
    recorder = sample.recorder(tmp_path / 'marked', approved=approved)
    recorder.offer(NAME, sample.result)
    found = record_of(tmp_path / 'marked')['instrument']
    assert (found['approved'], found['not_approved']) == ('no', ['software'])
    assert 'NOT as approved: software' in (
        tmp_path / 'marked' / NAME / 'page.html').read_text()
    path.write_text('stereo_speed_approved: 1\nsoftware: [abc]\n')
    with pytest.raises(InputError, match='software: found .abc., wanted SHA-256 in 64'):
        load_approved(path)
    assert Approved().unknown({}) == []


def test_parameters_are_read_from_a_file(sample, tmp_path):
    path = tmp_path / 'c.yaml'
    path.write_text('particles: 300\nenforcement: {decision: {unit: mph, threshold_kmh: 20}}\n')
    config = load_enforcement_config(path)
    assert config.decision == DecisionConfig(unit='mph', threshold_kmh=20.0)
    recorder = sample.recorder(tmp_path / 'e', config)
    assert recorder.offer(NAME, sample.result) is None
    assert recorder.refused == {'below_limit': 1}
    path.write_text('enforcement: {decision: {tolerance: 3}}\n')
    with pytest.raises(InputError, match='key: found enforcement.decision.tolerance'):
        load_enforcement_config(path)


@pytest.fixture(scope='module')
def recorded(sample):
    """Return the record of the sample for some parameters, without its lists of parameters."""
    result = sample.result
    decision, _ = decide(result, 45 * 0.44704, EnforcementConfig().decision)
    images = [tuple(sample.ring.get(side, ns) for side, ns in zip(
        ('left', 'right'), (pair.stamp_ns, pair.right_image_ns))) for pair in result.trace.pairs]
    case = Violation(NAME, result, result.trace, decision, images)

    @cache
    def record(config):
        setting = replace(sample.setting, config=config)
        out = json.loads(record_files(case, 1, setting, whole=False)[1])
        del out['parameters'], out['files']['page.html'], out['files']['page.pdf']
        return out
    return record


@pytest.mark.slow
@pytest.mark.parametrize(('name', 'value'), [
    ('pictures', 2), ('crop_margin', 0.5), ('instrument_name', 'S-17'), ('place', 'A 1, km 3')])
def test_recorded_content_follows_the_parameters(recorded, name, value):
    config = EnforcementConfig()
    changed = replace(config, evidence=replace(config.evidence, **{name: value}))
    assert recorded(config) != recorded(changed)


def test_every_evidence_parameter_is_tested():
    tested = {'pictures', 'crop_margin', 'instrument_name', 'place',  # above
              'most_recompute_mps', 'ring_s', 'ring_mib', 'least_free_mib', 'retention_days',
              'unapproved'}
    assert tested == {field.name for field in fields(EvidenceConfig)}
    rings = [ImageRing.of(EvidenceConfig(ring_s=s, ring_mib=mib)) for s, mib in (
        (30.0, 1024), (1.0, 1024), (30.0, 16))]
    for ring in rings:
        for second in range(20):
            ring.add('left', second * 10 ** 9, SourceImage('jpeg', bytes(1 << 20)))
    assert [len(ring) for ring in rings] == [20, 2, 16]


def test_expired_calibration_makes_no_record(sample, tmp_path):
    site = replace(sample.setting.place.site, calibrated=date(2001, 1, 1))
    setting = replace(sample.setting, place=replace(sample.setting.place, site=site))
    recorder = sample._replace(setting=setting).recorder(tmp_path)
    assert recorder.offer(NAME, sample.result) is None
    assert recorder.refused == {'calibration_expired': 1}
    recorder.store.close()


@pytest.mark.slow
def test_disclosed_copy_shows_only_the_vehicle(written, tmp_path):
    folder = disclose(written / NAME, tmp_path)
    told, record = json.loads((folder / 'disclosure.json').read_text()), record_of(written)
    assert told['speed'] == record['speed'] and not (folder / 'raw').exists()
    for number, picture in enumerate(record['pictures'], 1):
        plain = cv2.imread(str(written / NAME / picture['left'])).astype(float)
        shown = cv2.imread(str(folder / f'{number}_left.jpg')).astype(float)
        (x0, y0), (x1, y1) = (np.array(f(picture['left_front_px'], axis=0)).astype(int)
                              for f in (np.min, np.max))
        low = slice(y0 + round(0.6 * (y1 - y0)), y1), slice(x0 + 1, x1)
        assert np.abs(plain[low] - shown[low]).mean() < 6  # as JPEG keeps it
        # elsewhere no detail remains: neighbours differ far less than before
        plain[y0 - 2:y1 + 2, x0 - 2:x1 + 2] = shown[y0 - 2:y1 + 2, x0 - 2:x1 + 2] = 0
        outside = np.ones(plain.shape[:2], bool)
        outside[y0 - 8:y1 + 8, x0 - 8:x1 + 8] = False

        def detail(image):
            return np.percentile(np.abs(np.diff(image, axis=1)).max(axis=2)[outside[:, 1:]], 99)
        assert detail(shown) < 0.25 * detail(plain)
    hidden = disclose(written / NAME, tmp_path / 'hidden', hide_plate=True)
    assert (hidden / '1_left.jpg').read_bytes() != (folder / '1_left.jpg').read_bytes()


def test_page_describes_the_files_beside_it(written, tmp_path):
    folder = disclose(written / NAME, tmp_path)
    whole, copy = ((at / 'page.html').read_text() for at in (written / NAME, folder))
    assert 'unmarked originals' in whole and 'blurred' not in whole
    assert 'unmarked originals' not in copy and 'is blurred' in copy


@pytest.mark.parametrize('data', [b'', b'no image', None], ids=['empty', 'other', 'missing'])
def test_unreadable_image_is_named(evidence, data):
    path = evidence / NAME / 'raw' / '0005_left.png'
    path.unlink() if data is None else path.write_bytes(data)
    with pytest.raises(InputError, match='0005_left.png: image: .* wanted a whole JPEG or PNG'):
        recompute(evidence / NAME)


def test_stamp_ahead_of_the_clock_deletes_nothing(evidence, sample, monkeypatch):
    week = EnforcementConfig(evidence=EvidenceConfig(retention_days=7))
    recorder, day_ns = sample.recorder(evidence, week), 86_400 * 10 ** 9
    monkeypatch.setattr('time.time_ns', lambda: sample.result.last_ns + 6 * day_ns)
    assert recorder.delete_older(2 ** 62) == []
    monkeypatch.setattr('time.time_ns', lambda: sample.result.last_ns + 8 * day_ns)
    assert recorder.delete_older(sample.result.last_ns + 6 * day_ns) == []
    assert recorder.delete_older(2 ** 62) == [NAME]
    recorder.store.close()


@pytest.mark.slow
def test_plot_is_in_the_unit_of_the_limit(sample):
    trace, lanes = sample.result.trace, sample.setting.place.lanes
    updates = [pair.update for pair in trace.pairs if pair.update is not None]
    plots = [speed_plot(updates, sample.result, lanes, SpeedUnit(name)) for name in
             ('km/h', 'mph')]
    assert plots[0] != plots[1]


def test_changed_record_is_not_disclosed(evidence, tmp_path):
    (evidence / NAME / 'site.yaml').write_text('other')
    with pytest.raises(InputError, match='site.yaml was changed, wanted one record as it was'):
        disclose(evidence / NAME, tmp_path / 'out')
    assert not (tmp_path / 'out').exists()


def test_ring_is_limited_in_bytes_and_time():
    ring = ImageRing(1000, 50)
    for ns in range(0, 200, 10):
        ring.add('left', ns, SourceImage('jpeg', bytes(100)))
        ring.add('left', ns, SourceImage('jpeg', bytes(100)))  # sent twice
    assert len(ring) == 6 and ring.bytes == 600
    assert ring.get('left', 190) is not None and ring.get('left', 130) is None
    ring.add('right', 195, SourceImage('jpeg', bytes(900)))
    assert ring.bytes <= 1000 and ring.get('right', 195) is not None
    # a jump of time drops images of another time, as soon as two images tell of it
    ring.add('left', 5, SourceImage('jpeg', bytes(10)))
    assert ring.get('left', 5) is None and ring.get('right', 195) is not None
    ring.add('left', 15, SourceImage('jpeg', bytes(10)))
    assert len(ring) == 2 and ring.get('left', 5) is not None


def test_wrong_stamps_do_not_empty_the_ring():
    """An hour ahead, 0, and once more, of a camera that is an image a second."""
    ring, image, second = ImageRing(10 ** 6, 30 * 10 ** 9), SourceImage('jpeg', bytes(1)), 10 ** 9
    for k in range(100, 120):
        for side in ('left', 'right'):
            ring.add(side, k * second, image)
    for wrong in ((3700 * second,), (0, 3700 * second)):
        for ns in wrong:
            ring.add('left', ns, image)
        ring.add('left', 120 * second, image)
        assert len(ring) == 41 and ring.get('left', 100 * second) is not None
        assert ring.may_come('left', 121 * second)


def test_time_that_has_jumped_back_is_kept_for_both_sides():
    ring, image = ImageRing(1000, 100), SourceImage('jpeg', bytes(1))
    for ns in (1000, 1010, 5, 15):
        for side in ('left', 'right'):
            ring.add(side, ns, image)
    assert len(ring) == 4 and ring.get('left', 5) is not None and ring.get('right', 5) is not None


def test_trace_and_pass_are_read_back_from_messages(sample):
    from stereo_speed.io.pass_json import pass_text
    from stereo_speed.io.trace_json import result_of, trace_text
    result = sample.result
    found = result_of(pass_text('run', result), trace_text('run', result), 'passes')
    for name in ('track', 'lane', 'lane_to', 'first_ns', 'last_ns', 'pairs', 'speed_mps',
                 'speed_std_mps', 'verdict', 'smoothed', 'smoothed_std', 'budget', 'end',
                 'direction', 'vehicle'):
        assert getattr(found, name) == getattr(result, name), name
    for one, other in zip(found.trace.pairs, result.trace.pairs, strict=True):
        assert (one.stamp_ns, one.particles, one.motion) == (
            other.stamp_ns, other.particles, other.motion)
        for field in TrackUpdate.__dataclass_fields__:
            np.testing.assert_array_equal(getattr(one.update, field),
                                          getattr(other.update, field))
    with pytest.raises(InputError, match='passes: pass: found'):
        result_of('{}', '{}', 'passes')


def test_limit_is_in_the_unit_of_the_site(written):
    assert record_of(written)['speed']['limit'] == pytest.approx(45 * 0.44704 / KMH_MPS, abs=1e-5)
    assert Path(SAMPLE / 'site.yaml').read_text() == (written / NAME / 'site.yaml').read_text()


def test_an_image_may_come_until_a_later_one_of_its_side_has():
    ring, image = ImageRing(1000, 100), SourceImage('jpeg', bytes(1))
    assert ring.may_come('left', 5)
    ring.add('left', 4, image)
    assert ring.may_come('left', 5) and not ring.may_come('left', 4)
    ring.add('right', 6, image)
    assert ring.may_come('left', 5) and not ring.may_come('right', 5)
    ring.add('left', 6, image)
    assert not ring.may_come('left', 5)
    ring.add('left', 1000, image)
    ring.add('left', 7, image)  # time has jumped back, so the images after 1000 have gone
    assert ring.may_come('left', 8) and not ring.may_come('left', 1010)


def test_instrument_has_the_site_that_was_read_though_its_file_has_changed(tmp_path):
    path = tmp_path / 'site.yaml'
    text = (SAMPLE / 'site.yaml').read_text()
    path.write_text(text)
    with StereoBag(SAMPLE / 'bag') as bag:
        place = MeasuringSite.of(load_site(path), bag.rig)
    for change in (lambda: path.write_text(text.replace('45 mph', '30 mph')), path.unlink):
        change()
        assert Instrument.of('run', place, PipelineConfig()).site_yaml == text
