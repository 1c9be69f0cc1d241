# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Small breaks of the package that would lose a truth or mislead; the tests must catch each."""
