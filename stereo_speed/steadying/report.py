# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The report on a rig that does not stand still."""
from __future__ import annotations

from dataclasses import asdict
from typing import Any

from .steadier import Steadier, Steadiness

_DIGITS = 5  # decimals of degrees, finer than anything measured here


def steadiness_summary(state: Steadiness) -> dict[str, Any]:
    """Return the state as JSON values."""
    return {key: [round(v, _DIGITS) + 0.0 for v in value] if isinstance(value, tuple) else value
            for key, value in asdict(state).items()}


def steadiness_lines(state: Steadiness) -> list[str]:
    """Return lines for the user; none for a rig that stood still."""
    out = []
    if state.swayed:
        out.append(f'the rig swayed in {state.swayed} of {state.looks} examined pairs, r.m.s. '
                   f'{_angles(state.sway_rms_deg)}; its mean rotation since the site was learnt '
                   f'is {_angles(state.rest_deg, "+")}')
        if any(state.standing_std_deg):
            out.append('the site is taken to show the rig as it stands in the mean of some pairs, '
                       f'known to {_angles(state.standing_std_deg)}; lines found by --refine-site '
                       'tell that better')
    if any(state.drift_deg):
        out.append(f'the right camera has turned by {_angles(state.drift_deg, "+")} since the '
                   f'first pair (± {_angles(state.drift_std_deg)})')
    if state.unknown:
        out.append(f'the pose of the rig is unknown in {state.unknown} of {state.looks} examined '
                   'pairs')
    return out


def warning(steadier: Steadier) -> str:
    """Return a warning about the current state of the rig; empty if there is none."""
    if steadier.drift.too_far:
        return 'the right camera has turned too far: calibrate again'
    if steadier.settling:
        return 'the rig sways, and its rest is not known yet: nothing is measured'
    if steadier.lost:
        return 'the rig sways and its pose is unknown'
    return ('the right camera has turned; measuring with its angles corrected'
            if steadier.drift.turned else '')


def _angles(degrees: tuple[float, float, float], sign: str = '') -> str:
    pan, tilt, roll = (f'{v:{sign}.4f}°' for v in degrees)
    return f'pan {pan}, tilt {tilt}, roll {roll}'
