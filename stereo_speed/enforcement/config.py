# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of enforcement: when a pass is a violation, and what is kept of it."""
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
    """When a pass is a violation; by default what OIML R 91 and its kin allow for."""

    unit: str = parameter(
        'km/h', doc='unit in which speeds are considered and shown to people', choices=UNITS)
    tolerance_kmh: float = parameter(
        3.0, 0.0, 50.0, 'km/h', 'taken off a measured speed, up to that from which on a share of '
        'it is more')
    tolerance_percent: float = parameter(
        3.0, 0.0, 50.0, '%', 'share taken off a measured speed where it is more than '
        'tolerance_kmh: above 100 km/h by default')
    margin_sigmas: float = parameter(
        3.0, 0.0, 20.0, '', 'the speed less its tolerance must be above the limit by so many of '
        'its own sigmas')
    threshold_kmh: float = parameter(
        0.0, 0.0, 100.0, 'km/h', 'the considered speed must be above the limit by more than this')
    least_kmh: float = parameter(
        20.0, 0.0, 400.0, 'km/h', 'least speed of the declared interval; no record below it',
        below='most_kmh')
    most_kmh: float = parameter(
        180.0, 1.0, 400.0, 'km/h', 'greatest speed of the declared interval; no record above it')
    demand_second_estimate: bool = parameter(
        True, doc='no record of a pass without a second estimate')
    second_sigmas: float = parameter(
        3.0, 0.0, 20.0, '', 'no record where both estimates differ by more of their sigmas '
        'together')
    second_apart_kmh: float = parameter(
        2.0, 0.0, 50.0, 'km/h', 'no record where both estimates differ by more')
    least_class_probability: float = parameter(
        0.95, 0.0, 1.0, '', 'a class that is less probable is in doubt: the greatest limit of any '
        'class counts')
    calibration_months: float = parameter(
        12.0, 0.1, 1200.0, 'months', 'no record with a calibration that is older, by the date '
        'that the site file gives')
    demand_calibration_date: bool = parameter(
        False, doc='no record where the site file gives no date')
    clear_share: float = parameter(
        0.25, 0.0, 5.0, '', 'no record where the front of another vehicle comes nearer in an '
        'image than this share of the size of the front that was measured')
    evidence_span_s: float = parameter(
        0.15, 0.0, 10.0, 's', 'least time between the first and the last pair of the evidence')


@dataclass(frozen=True)
class EvidenceConfig(CheckedRecord):
    """What is kept of a violation, and for how long."""

    pictures: int = parameter(
        3, 2, 20, '', 'whole pairs kept of a pass, evenly spread over it')
    crop_margin: float = parameter(
        1.0, 0.0, 20.0, '', 'images to measure again from reach beyond the front by this share of '
        'its size; whole images are kept where that is too little')
    most_recompute_mps: float = parameter(
        0.01, 0.0, 1.0, 'm/s', 'no record where measuring again from what is kept gives another '
        'speed by more')
    ring_s: float = parameter(
        30.0, 0.1, 600.0, 's', 'images are kept for so long while passes may still need them')
    ring_mib: int = parameter(
        1024, 16, 100000, 'MiB', 'and for no longer than they fit into this')
    least_free_mib: int = parameter(
        256, 0, 100000, 'MiB', 'free space on the disk below which no record is begun')
    retention_days: int = parameter(
        0, 0, 36500, 'days', 'records older than this are deleted, with an entry in the chain; '
        '0 keeps them')
    unapproved: str = parameter(
        'mark', doc='what happens where approved fingerprints are given and others run: records '
        'say so, or there are none', choices=UNAPPROVED)
    instrument_name: str = parameter(
        'not given', doc='serial number or name of the instrument, for its records')
    place: str = parameter(
        'not given', doc='place of the instrument as people know it, for its records')


@dataclass(frozen=True)
class EnforcementConfig(CheckedRecord):
    """All parameters of enforcement."""

    decision: DecisionConfig = section(DecisionConfig, 'when a pass is a violation')
    evidence: EvidenceConfig = section(EvidenceConfig, 'what is kept of a violation')


def load_enforcement_config(path: Optional[Union[str, Path]]) -> EnforcementConfig:
    """
    Read the section ``enforcement`` of a file of parameters.

    :param path: YAML; None gives the defaults.
    :raises InputError: an unreadable file, an unknown key, a value out of bounds.
    """
    data = {} if path is None else read_yaml_mapping(path).get(ENFORCEMENT, {})
    return record_of(EnforcementConfig, data, path, f'{ENFORCEMENT}.')
