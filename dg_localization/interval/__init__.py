"""Interval arithmetic: the only room that rounds."""
