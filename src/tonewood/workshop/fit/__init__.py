"""From measured frequency responses to a body of real modes: files, noise, poles, passive shapes, a bundle."""
