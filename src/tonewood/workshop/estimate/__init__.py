"""An instrument from recordings of single notes: analysis, indirect inference, a bundle, distances."""
