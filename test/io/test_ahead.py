# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Reading ahead changes neither the items nor their order."""
from __future__ import annotations

import threading

import pytest
from stereo_speed.io.ahead import ahead


@pytest.mark.parametrize('most', [1, 3, 50])
def test_items_come_in_the_same_order(most):
    assert list(ahead(range(20), most)) == list(range(20))
    assert list(ahead([], most)) == []


def test_items_are_fetched_ahead_up_to_the_limit():
    third, fetched = threading.Event(), []

    def items():
        for number in range(10):
            fetched.append(number)
            if number == 2:
                third.set()
            yield number
    coming = ahead(items(), 2)
    assert next(coming) == 0
    assert third.wait(30)  # fetched though only the first was requested
    coming.close()
    assert len(fetched) <= 3


def test_error_comes_after_the_items_before_it():
    def items():
        yield 1
        yield 2
        raise OSError('torn')
    coming = ahead(items())
    assert [next(coming), next(coming)] == [1, 2]
    with pytest.raises(OSError, match='torn'):
        next(coming)
