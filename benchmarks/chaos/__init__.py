# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""A hostile day over DDS: whatever happens, no old answer looks new, and the node comes back."""
