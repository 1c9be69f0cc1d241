"""Answers in pieces: rigid pieces solved one by one, and what they make together."""
