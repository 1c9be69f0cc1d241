"""From the hypotheses of the solver to placements in the fixed frame."""
