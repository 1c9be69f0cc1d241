# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What a cover means: placements, proofs, rigidity, hypotheses."""
