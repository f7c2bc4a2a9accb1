# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
from ..core.threads import one_blas_thread

one_blas_thread()
