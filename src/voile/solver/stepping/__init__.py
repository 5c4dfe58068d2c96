"""Paths of equilibria: step lengths and load paths."""
