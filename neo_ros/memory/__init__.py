"""What a robot keeps of a scene: drawing, pose search, alignment, fusion."""
