"""Changes a trained scene where later bags show that it has changed, and nowhere else."""
