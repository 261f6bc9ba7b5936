"""Bags replayed with their scores: one, or many as jobs of their own, here or on a cluster."""
