"""The lifecycle node, its parameters and diagnostics, and bags on a real graph."""
