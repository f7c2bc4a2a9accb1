# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Errors a user can cause, under one base class, each a single clear line."""
from __future__ import annotations


class StereoSpeedError(Exception):
    """Base class of every error this package raises on purpose."""


class InputError(StereoSpeedError):
    """
    Bad input: says where, what, found, wanted, on one line.

    :param where: file (or topic) that holds the fault.
    :param what: the field, key or thing at fault.
    :param found: what was there; shown by ``str``.
    :param wanted: what should have been there.
    """

    def __init__(self, where: object, what: str, found: object, wanted: str) -> None:
        self.where, self.what, self.found, self.wanted = str(where), what, str(found), wanted
        line = f'{self.where}: {what}: found {self.found}, wanted {wanted}'
        super().__init__(' '.join(line.split()))

    def __reduce__(self) -> tuple[type, tuple[str, ...]]:
        """Pickle by what it says, so that it comes out of worker processes whole."""
        return type(self), (self.where, self.what, self.found, self.wanted)


class CalibrationError(InputError):
    """A camera or rig calibration that cannot be used."""


class SiteError(InputError):
    """A site or init file that cannot be used."""


class BagError(InputError):
    """A bag that cannot be read, or that lacks what is needed."""
