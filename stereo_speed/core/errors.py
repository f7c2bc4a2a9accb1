# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Errors that a user can cause, under one base class; each message is a single line."""
from __future__ import annotations


class StereoSpeedError(Exception):
    """Base class of all errors that this package raises deliberately."""


class InputError(StereoSpeedError):
    """
    Bad input; the message says in one line where, what, found and wanted.

    :param where: file or topic that contains the fault.
    :param what: field, key or item at fault.
    :param found: value found there; shown by ``str``.
    :param wanted: description of what is legal there.
    """

    def __init__(self, where: object, what: str, found: object, wanted: str) -> None:
        self.where, self.what, self.found, self.wanted = str(where), what, str(found), wanted
        line = f'{self.where}: {what}: found {self.found}, wanted {wanted}'
        super().__init__(' '.join(line.split()))

    def __reduce__(self) -> tuple[type, tuple[str, ...]]:
        """Pickle by the constructor's arguments, so that worker processes can pass it on."""
        return type(self), (self.where, self.what, self.found, self.wanted)


class CalibrationError(InputError):
    """A camera or rig calibration that cannot be used."""


class SiteError(InputError):
    """A site or init file that cannot be used."""


class BagError(InputError):
    """A bag that cannot be read, or that lacks what is needed."""
