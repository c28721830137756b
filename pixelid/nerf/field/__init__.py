"""The radiance field: bricks of vertices, how rays are rendered through it, what holds it smooth."""
