# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""From a cover to hypotheses: placements and their proofs."""
