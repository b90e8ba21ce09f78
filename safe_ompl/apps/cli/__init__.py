"""The command line program `safe-ompl`."""
