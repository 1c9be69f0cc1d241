"""Bags: localize one, or replay it on live topics."""
