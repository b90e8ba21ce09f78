"""Safety-oriented robot arm motion planning for OMPL."""
