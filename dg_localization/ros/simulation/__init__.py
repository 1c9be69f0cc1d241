"""The simulated fleet on real topics."""
