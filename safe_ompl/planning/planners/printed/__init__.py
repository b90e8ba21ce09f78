"""The planners exactly as the papers print them, beside which ours are measured."""
