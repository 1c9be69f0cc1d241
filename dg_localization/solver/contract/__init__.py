"""The contractors of the paper, and their fixed point (Section 4)."""
