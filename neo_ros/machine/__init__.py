"""Files written whole, compiled kernels, processes, and what this machine is."""
