# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Calibrations that are young, old, expired or in the future; the date in a site file."""
from __future__ import annotations

from datetime import date, datetime, timezone

import pytest
from stereo_speed.core.errors import SiteError
from stereo_speed.site.calibration_age import calibration_age
from stereo_speed.site.file import load_site
from stereo_speed.site.write import site_text

DAY = date(2026, 1, 31)


def stamp_ns(*day):
    return int(datetime(*day, tzinfo=timezone.utc).timestamp()) * 10 ** 9


@pytest.mark.parametrize(('day', 'expired', 'said'), [
    ((2026, 1, 31), False, ''), ((2026, 12, 30), False, ''),
    ((2027, 1, 1), False, 'expires after 12 months'), ((2027, 1, 31), False, 'expires'),
    ((2027, 2, 2), True, 'expired'), ((2026, 1, 29), True, 'after the pairs of 2026-01-29'),
    ((2026, 1, 30, 22), False, '')])  # when it is the 31st already in the east
def test_ages(day, expired, said):
    found = calibration_age(DAY, stamp_ns(*day), 12.0)
    assert found.expired == expired
    assert said in found.text and bool(said) == bool(found.text)


def test_site_without_a_calibration_date_has_no_warning():
    assert calibration_age(None, stamp_ns(2030, 1, 1), 12.0).text == ''


@pytest.mark.parametrize('text', ['2026-01-31', "'2026-01-31'"])
def test_calibration_date_in_a_site_file(sample, tmp_path, text):
    path = tmp_path / 'site.yaml'
    path.write_text((sample / 'site.yaml').read_text() + f'\ncalibrated: {text}\n')
    site = load_site(path)
    assert site.calibrated == DAY
    path.write_text(site_text(site))
    assert load_site(path).calibrated == DAY


@pytest.mark.parametrize('text', ['soon', '2026', "'2026-13-01'", '2026-01-31 10:00:00'])
def test_invalid_date_is_refused_in_one_line(sample, tmp_path, text):
    path = tmp_path / 'site.yaml'
    path.write_text((sample / 'site.yaml').read_text() + f'\ncalibrated: {text}\n')
    with pytest.raises(SiteError, match='calibrated: found .*, wanted a day such as'):
        load_site(path)
