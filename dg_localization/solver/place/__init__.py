"""What a cover means: placements, proofs, rigidity, hypotheses."""
