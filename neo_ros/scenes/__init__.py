"""The scene folder, posed images, floor maps, and where poses are sampled."""
