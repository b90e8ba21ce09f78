"""Motion beside people who move: replanning that is proven at every instant, and its simulation."""
