"""What the pipeline is made of: a run and its folder, checkpoints, views, the report."""
