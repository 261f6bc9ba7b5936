"""stub for now."""
def demo() -> None:
    """Show it."""
