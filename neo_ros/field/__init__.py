"""The voxel radiance field: rays, rendering, fitting, panoramas."""
