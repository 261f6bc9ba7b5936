"""Rivals, protocols, suites and their tables."""
