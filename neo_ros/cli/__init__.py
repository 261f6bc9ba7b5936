"""The command line: one file a command; rooms are imported when it runs."""
