"""What a fit knows, and what it must not claim: curvature, few pixels, poor stimuli, profiles."""
