"""A reconstructed scene to look at: views along a way, videos, depth, a mesh, Gaussian splats."""
