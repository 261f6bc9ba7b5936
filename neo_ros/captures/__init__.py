"""One reader a format, structure from motion, and the import into a scene folder."""
