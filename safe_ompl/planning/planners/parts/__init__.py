"""Parts that planners hold: trees, roadmaps, the choice of nodes, motions that slide from danger."""
