# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""From a snapshot to a problem: distances, rays, angles and chiralities of the points."""
