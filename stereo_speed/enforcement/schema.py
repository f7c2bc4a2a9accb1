# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Check records against the JSON Schema of ``record.json``."""
from __future__ import annotations

from functools import cache
import json
from pathlib import Path
from typing import Any

import jsonschema

SCHEMA = Path(__file__).with_name('record.schema.json')


@cache
def _validator() -> jsonschema.Draft202012Validator:
    return jsonschema.Draft202012Validator(json.loads(SCHEMA.read_text(encoding='utf-8')))


def schema_fault(record: Any) -> str:
    """Return how a record violates its schema, on one line; empty where it is valid."""
    error = jsonschema.exceptions.best_match(_validator().iter_errors(record))
    if error is None:
        return ''
    return f'{error.json_path}: {" ".join(error.message.split())[:200]}'
