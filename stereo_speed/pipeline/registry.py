# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Trackers and detectors by name: those of this package, and those of other packages.

Another package provides one through an entry point of the group ``stereo_speed.trackers`` or
``stereo_speed.detectors`` that names its class.  A class is imported only when it is used, so that
measuring with one does not load the others.
"""
from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
import importlib
from importlib.metadata import entry_points
from typing import Generic, Mapping, TypeVar, Union

from ..core.config import ConfigRecord, NoParameters, record_of
from ..core.errors import InputError
from ..detection.protocol import DetectorType
from ..tracking.protocol import TrackerType

Kind = TypeVar('Kind', bound=Union[TrackerType, DetectorType])


@dataclass(frozen=True)
class Registry(Generic[Kind]):
    """
    Classes of one kind by name.

    :param kind: ``tracker`` or ``detector``, for messages and keys.
    :param group: entry-point group for classes of other packages.
    :param own: name to ``module:class`` for classes of this package.
    """

    kind: str
    group: str
    own: Mapping[str, str]

    @cached_property
    def targets(self) -> dict[str, str]:
        """
        Return the ``module:class`` of every name, those of this package first.

        :raises InputError: two packages use the same name.
        """
        found = dict(self.own)
        for point in sorted(entry_points(group=self.group), key=lambda p: (p.name, p.value)):
            if found.setdefault(point.name, point.value) != point.value:
                raise InputError(f'entry points {self.group}', point.name,
                                 f'{found[point.name]} and {point.value}', 'one of them')
        return found

    @property
    def names(self) -> tuple[str, ...]:
        """Return all names."""
        return tuple(self.targets)

    def check(self, name: str, where: str = 'configuration') -> None:
        """
        Check a name.

        :raises InputError: an unknown name.
        """
        if name not in self.targets:
            raise InputError(where, self.kind, name, ', '.join(self.names))

    def load(self, name: str) -> Kind:
        """
        Return the class of a name.

        :raises InputError: an unknown name, or a class that cannot be imported.
        """
        self.check(name)
        module, _, attribute = self.targets[name].partition(':')
        try:
            found: Kind = getattr(importlib.import_module(module), attribute)
        except (ImportError, AttributeError) as error:
            raise InputError(f'{self.kind} {name}', self.targets[name], error,
                             'a class that can be imported') from None
        return found

    def settings(self, name: str, data: object, where: object) -> ConfigRecord:
        """
        Return the settings of a tracker or detector from a mapping of parameters.

        :param data: parameter to value; the others keep their defaults.
        :param where: file, for error messages.
        :raises InputError: an unknown name or key, or a value out of bounds.
        """
        kind: type[ConfigRecord] = getattr(self.load(name), 'Settings', NoParameters)
        return record_of(kind, data, where, f'{self.kind}s.{name}.')


_BASELINES = 'stereo_speed.lab.baselines'
TRACKERS: Registry[TrackerType] = Registry('tracker', 'stereo_speed.trackers', {
    'constrained': 'stereo_speed.tracking.constrained:ConstrainedTracker',
    'unconstrained': f'{_BASELINES}.unconstrained:UnconstrainedTracker',
    'triangulation': f'{_BASELINES}.triangulation:TriangulationTracker',
    'kalman': f'{_BASELINES}.kalman:KalmanTracker',
    'multimodal': f'{_BASELINES}.multimodal:MultimodalTracker',
    'flow': f'{_BASELINES}.optical_flow:FlowTracker'})
DETECTORS: Registry[DetectorType] = Registry('detector', 'stereo_speed.detectors', {
    'plane_sweep': 'stereo_speed.detection.detector:PlaneSweepDetector',
    'boxes': 'stereo_speed.detection.box_detector:BoxDetector'})
