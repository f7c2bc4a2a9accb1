# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The state of the measuring instrument: software, parameters, site and calibration.

The measuring program reports it as JSON, so that the evidence states what was running, not what
should have been.
"""
from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
import json
import math
from pathlib import Path
import tempfile
from typing import Any, Mapping, Optional

from .fingerprint import canonical, sha256, software_fingerprint
from ..core.config import record_of
from ..core.errors import InputError
from ..core.tracker_config import TrackerConfig
from ..io.results import software_versions
from ..io.trace_json import rig_of, rig_record
from ..pipeline.assembly import MeasuringSite
from ..pipeline.config import PipelineConfig, SiteConfig
from ..pipeline.registry import DETECTORS, TRACKERS
from ..site.file import load_site, Site
from ..site.lane_paths import lane_paths
from ..site.write import site_text

FORMAT = 1
_KINDS = {'run': str, 'software': str, 'versions': dict, 'parameters': dict, 'site_name': str,
          'site_yaml': str, 'calibration': dict}


@dataclass(frozen=True)
class Instrument:
    """
    The state of the instrument in one run.

    :param run: name of the run.
    :param software: fingerprint of the measuring package.
    :param versions: versions of the package and of the libraries that it uses.
    :param parameters: all parameters, in the form of ``PipelineConfig.summary``.
    :param site_name: name of the site.
    :param site_yaml: text of the site file; the refined one where the site was refined.
    :param calibration: the rig as used, in the form of :func:`..io.trace_json.rig_record`.
    :param self_test: time of the last passed self-test by the system's clock, ``passed_utc``, and
        the error of its speed, ``off_percent``; None where there was none.
    """

    run: str
    software: str
    versions: Mapping[str, str]
    parameters: Mapping[str, Any]
    site_name: str
    site_yaml: str
    calibration: Mapping[str, Any]
    self_test: Optional[Mapping[str, Any]] = None

    @classmethod
    def of(cls, run: str, place: MeasuringSite, config: PipelineConfig) -> Instrument:
        """
        Return the state of this process.

        :param run: name of the run.
        :param place: the site as used for measuring.
        :param config: the parameters.
        """
        used = config.with_tolerances(place.site.tolerances)
        return cls(run, software_fingerprint(), software_versions(),
                   json.loads(canonical(used.summary())), place.site.name, _site_yaml(place),
                   rig_record(place.rig))

    @classmethod
    def of_text(cls, text: str, where: object) -> Instrument:
        """
        Return the state that a message describes.

        :param text: text of :meth:`text`.
        :param where: topic, for errors.
        :raises InputError: the text is no such message.
        """
        try:
            data = json.loads(text)
            if data.pop('stereo_speed_instrument') != FORMAT:
                raise ValueError('another format')
            _check(data)
            return cls(**data)
        except (ValueError, TypeError, KeyError, AttributeError) as error:
            raise InputError(where, 'instrument', f'{type(error).__name__}: {error}',
                             'the state of an instrument as JSON') from None

    def text(self) -> str:
        """Return the state as one line of JSON."""
        fields = {name: getattr(self, name) for name in self.__dataclass_fields__}
        return canonical({'stereo_speed_instrument': FORMAT, **fields})

    def place(self, where: object) -> MeasuringSite:
        """
        Return the site as used for measuring.

        :param where: topic or file, for errors.
        :raises InputError: an invalid site, rig or parameter.
        """
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / 'site.yaml'
            path.write_text(self.site_yaml, encoding='utf-8')
            site = replace(load_site(path), name=self.site_name, where=str(where))
        return place_of(site, self.calibration, config_of(self.parameters, where), where)

    @cached_property
    def fingerprints(self) -> dict[str, str]:
        """Return the fingerprints of software, parameters, site and calibration."""
        return {'software': self.software, 'parameters': sha256(canonical(self.parameters)),
                'site': sha256(self.site_yaml), 'calibration': sha256(canonical(self.calibration))}


def _check(fields: Mapping[str, Any]) -> None:
    """
    Check the types of the fields that records copy from a message.

    :raises ValueError: a field has another type.
    """
    wrong = [name for name, kind in _KINDS.items() if not isinstance(fields[name], kind)]
    passed = fields['self_test']
    if passed is not None:
        off = passed['off_percent']
        if len(passed) != 2 or not isinstance(passed['passed_utc'], str) or not (
                off is None or isinstance(off, (int, float)) and math.isfinite(off)):
            wrong.append('self_test')
    if wrong:
        raise ValueError(f'another type of {", ".join(wrong)}')


def config_of(parameters: Mapping[str, Any], where: object) -> PipelineConfig:
    """
    Return the configuration of a summary.

    :param parameters: parameters in the form of ``PipelineConfig.summary``.
    :param where: file, for errors.
    :raises InputError: an unknown name or key, a value out of bounds.
    """
    try:
        tracker, detector = str(parameters['tracker']), str(parameters['detector'])
        TRACKERS.check(tracker, str(where))
        DETECTORS.check(detector, str(where))
        return PipelineConfig(
            record_of(TrackerConfig, parameters['parameters'], where), tracker, detector,
            {tracker: TRACKERS.settings(tracker, parameters['tracker_parameters'], where)},
            {detector: DETECTORS.settings(detector, parameters['detector_parameters'], where)},
            record_of(SiteConfig, parameters['site_parameters'], where))
    except KeyError as error:
        raise InputError(where, 'parameters', f'no {error.args[0]}',
                         'all parameters of a pipeline') from None


def place_of(site: Site, calibration: Mapping[str, Any], config: PipelineConfig,
             where: object) -> MeasuringSite:
    """
    Return the site as used for measuring.

    :param site: the site as read from its file.
    :param calibration: the measuring rig, with its correction applied.
    :param config: the parameters.
    :param where: file of the calibration, for errors.
    :raises InputError: values that make no rig or no road.
    """
    rig = rig_of(calibration, where)
    return MeasuringSite(site, rig, lane_paths(site, rig, config.site.road))


def _site_yaml(place: MeasuringSite) -> str:
    """Return the text of the site file that describes the site as used."""
    if place.refined is not None or place.corrected or not place.site.text:
        return site_text(place.site)
    return place.site.text
