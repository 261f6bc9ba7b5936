"""The built-in demo flat: its rooms, light, walks and pictures."""
