"""A render: options, blocks, resampling, and a plan of its cost."""
