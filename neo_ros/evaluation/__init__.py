"""Metrics, scores of a model or a bag, and how true the confidence is."""
