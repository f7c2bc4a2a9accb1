# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The parameters of the monocular tracker: what loads and what is refused."""
import pytest

from stereo_speed.core.config import load_config
from stereo_speed.core.errors import InputError
from stereo_speed.monocular.config import MonocularConfig


def test_config_there_and_back(tmp_path):
    path = tmp_path / 'file.yaml'
    path.write_text('{}')
    assert load_config(path, MonocularConfig) == MonocularConfig()
    path.write_text('particles: 300\nprior_noise: 0.1\n')
    assert load_config(path, MonocularConfig) == MonocularConfig(particles=300, prior_noise=0.1)


@pytest.mark.parametrize(('text', 'found'), [
    ('particles: 5', 'particles: found 5'), ('lambda_c: 1', 'key: found lamb'),
    ('- 1', 'top level: found list'), ('a: [', 'file: found'),
    ('prior_noise: .nan', 'prior_noise'), ('particles: many', 'particles')])
def test_what_is_refused(tmp_path, text, found):
    path = tmp_path / 'file.yaml'
    path.write_text(text)
    with pytest.raises(InputError, match=rf'file\.yaml: {found}'):
        load_config(path, MonocularConfig)
