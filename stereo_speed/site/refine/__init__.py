# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Refinement of a clicked site by the images of a bag, to a few hundredths of a pixel."""
