"""Raw data as they are published, one file per layout, on their way to the layout that reconstructions read."""
