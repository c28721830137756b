"""What becomes of a trained scene: scores, files, pictures, videos, meshes and splats."""
