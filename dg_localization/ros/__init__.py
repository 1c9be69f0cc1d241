# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The ROS 2 side: the node and the other executables."""
