"""Fleets whose true placement is known."""
