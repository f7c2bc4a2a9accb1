# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Decides whether an arrived pair may be measured."""
from __future__ import annotations

from typing import Optional

from .health import ERROR, Repeats, State, WARN
from .measuring_context import Configuration, MeasuringContext
from .order_watch import OrderWatch
from ..core.records import StereoPair
from ..geometry.rig import StereoRig
from ..site.calibration_age import calibration_age
from ..steadying.steadier import Steadier


class Admission:
    """
    See the module's docstring.

    A pair is withheld if one of its images repeats the previous one. Every pair is while the
    calibration is in doubt or too old, the views are swapped, the rig has moved, or the self-test
    has not passed.

    :param context: what the node's threads share.
    :param configuration: its configuration.
    """

    def __init__(self, context: MeasuringContext, configuration: Configuration) -> None:
        self._context, self._configuration = context, configuration
        self._repeats = (Repeats(), Repeats())
        self._order = OrderWatch()

    def begin(self, rig: StereoRig, pair: StereoPair) -> None:
        """Begin to check the order of the views, before the first pair is to be measured."""
        self._order.begin(rig, pair)

    def admit(self, pair: StereoPair, version: int, steadier: Optional[Steadier]) -> bool:
        """
        Return whether a pair may be measured; count it if not.

        Pairs with new images are shown to the watch over the rig in either case.

        :param pair: the next pair.
        :param version: number of the calibration that measuring uses.
        :param steadier: follows the rig's rotation; None if nothing does.
        """
        context, configuration = self._context, self._configuration
        same = [r.add(image) for r, image in zip(self._repeats, (pair.left, pair.right))]
        context.counts.frozen.add(any(same))
        if not any(same):
            context.rig_watch.take(pair, None if steadier is None else steadier.rest)
        configuration.age = calibration_age(
            configuration.site.calibrated, pair.stamp_ns, context.settings.calibration_months)
        moot = (not configuration.calibration.holds(version) or self._is_crossed(pair)
                or context.self_test.withholds or context.rig_watch.withholds
                or configuration.age.expired)
        context.counts.withheld += moot
        return not (any(same) or moot)

    def _is_crossed(self, pair: StereoPair) -> bool:
        """Return whether the views are swapped."""
        rig = self._configuration.calibration.current[1]
        return self._order.crossed if rig is None else self._order.take(rig, pair)

    def tell(self, state: State) -> None:
        """Add swapped views, and the age of the calibration, to a state."""
        age = self._configuration.age
        if self._order.crossed:
            state.find(ERROR, 'the views are swapped: nothing is measured')
        if age.text:
            state.find(ERROR if age.expired else WARN, age.text)

    def close(self) -> None:
        """Shut down the thread that checks the order of the views."""
        self._order.close()
