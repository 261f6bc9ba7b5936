"""Makes the scene memory and its landmarks, from the field and the photos."""
