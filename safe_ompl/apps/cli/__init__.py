"""The command line: `safe-ompl`."""
