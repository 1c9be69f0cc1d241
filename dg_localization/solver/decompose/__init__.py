"""Rigid pieces and joints of a fleet, from the graph of measured pairs alone."""
