"""Single pictures: headers, photos, exposure, sharpness, filling."""
