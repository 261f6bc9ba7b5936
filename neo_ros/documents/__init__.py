"""The tables of docs/, made from results/, the command line and the code: `make docs`."""
