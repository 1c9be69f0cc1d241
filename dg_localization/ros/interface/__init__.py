# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The interface of a fleet on ROS: parameters, input topics, outputs and diagnostics."""
