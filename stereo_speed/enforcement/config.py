# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of enforcement: when a pass is a violation, and which evidence is kept."""
from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Optional, Union

from ..core.config import CheckedRecord, parameter, read_yaml_mapping, record_of, section
from ..pipeline.config import ENFORCEMENT

UNITS = ('km/h', 'mph')
UNAPPROVED = ('mark', 'refuse')


@dataclass(frozen=True)
class DecisionConfig(CheckedRecord):
    """When a pass is a violation; the defaults follow OIML R 91 and similar rules."""

    unit: str = parameter(
        'km/h', doc='unit in which speeds are rounded and shown', choices=UNITS)
    tolerance_kmh: float = parameter(
        3.0, 0.0, 50.0, 'km/h', 'tolerance subtracted from a measured speed, or tolerance_percent '
        'of it where that is more')
    tolerance_percent: float = parameter(
        3.0, 0.0, 50.0, '%', 'share subtracted from a measured speed where that is more than '
        'tolerance_kmh: above 100 km/h by default')
    margin_sigmas: float = parameter(
        3.0, 0.0, 20.0, '', 'number of its own sigmas by which the speed minus tolerance must '
        'exceed the limit')
    threshold_kmh: float = parameter(
        0.0, 0.0, 100.0, 'km/h', 'the considered speed must exceed the limit by more than this')
    least_kmh: float = parameter(
        20.0, 0.0, 400.0, 'km/h', 'lower end of the declared interval; no record below it',
        below='most_kmh')
    most_kmh: float = parameter(
        180.0, 1.0, 400.0, 'km/h', 'upper end of the declared interval; no record above it')
    demand_second_estimate: bool = parameter(
        True, doc='no record for a pass without a second estimate')
    second_sigmas: float = parameter(
        3.0, 0.0, 20.0, '', 'no record where the two estimates differ by more than this number of '
        'combined sigmas')
    second_apart_kmh: float = parameter(
        2.0, 0.0, 50.0, 'km/h', 'no record where the two estimates differ by more')
    least_class_probability: float = parameter(
        0.95, 0.0, 1.0, '', 'a class of lower probability is in doubt: then the greatest limit of '
        'any class applies')
    calibration_months: float = parameter(
        12.0, 0.1, 1200.0, 'months', 'no record with an older calibration, by the date in the '
        'site file')
    demand_calibration_date: bool = parameter(
        False, doc='no record where the site file has no calibration date')
    clear_share: float = parameter(
        0.25, 0.0, 5.0, '', 'no record where the front of another vehicle comes closer in an '
        'image than this share of the size of the measured front')
    evidence_span_s: float = parameter(
        0.15, 0.0, 10.0, 's', 'least time between the first and the last pair of the evidence')


@dataclass(frozen=True)
class EvidenceConfig(CheckedRecord):
    """Which evidence of a violation is kept, and for how long."""

    pictures: int = parameter(
        3, 2, 20, '', 'number of whole pairs kept, evenly spread over the pass')
    crop_margin: float = parameter(
        1.0, 0.0, 20.0, '', 'margin, as a share of the front size, of the crops that are kept '
        'for measuring again; whole images are kept where crops do not suffice')
    most_recompute_mps: float = parameter(
        0.01, 0.0, 1.0, 'm/s', 'no record where measuring again from the kept images differs '
        'by more')
    ring_s: float = parameter(
        30.0, 0.1, 600.0, 's', 'how long images are buffered for passes that may need them')
    ring_mib: int = parameter(
        1024, 16, 100000, 'MiB', 'memory for buffered images; the oldest are dropped beyond it')
    least_free_mib: int = parameter(
        256, 0, 100000, 'MiB', 'free disk space below which no record is started')
    retention_days: int = parameter(
        0, 0, 36500, 'days', 'age above which records are deleted, with an entry in the chain; '
        '0 keeps them')
    unapproved: str = parameter(
        'mark', doc='what happens where the running fingerprints are not approved ones: '
        'records are marked, or none are written', choices=UNAPPROVED)
    instrument_name: str = parameter(
        'not given', doc='serial number or name of the instrument, for its records')
    place: str = parameter(
        'not given', doc='common name of the place of the instrument, for its records')


@dataclass(frozen=True)
class EnforcementConfig(CheckedRecord):
    """All parameters of enforcement."""

    decision: DecisionConfig = section(DecisionConfig, 'when a pass is a violation')
    evidence: EvidenceConfig = section(EvidenceConfig, 'evidence kept of a violation')


def load_enforcement_config(path: Optional[Union[str, Path]]) -> EnforcementConfig:
    """
    Read the section ``enforcement`` of a parameter file.

    :param path: YAML; None gives the defaults.
    :raises InputError: an unreadable file, an unknown key, a value out of bounds.
    """
    data = {} if path is None else read_yaml_mapping(path).get(ENFORCEMENT, {})
    return record_of(EnforcementConfig, data, path, f'{ENFORCEMENT}.')
